"""Paths and points that are corrected in one answer."""
