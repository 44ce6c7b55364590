"""Compiled scan of many small candidates."""
