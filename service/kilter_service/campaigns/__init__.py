"""Measurement campaigns: uploads and their checks, what the rows say, rows that look wrong."""
