"""Robots, campaigns, versions and jobs as the documents that a server sends, found by what stands for their ids."""
