"""Readers of files of measurements, one in a file."""
