"""Frames from digitised points."""
