"""Measurement campaigns and their observations."""
