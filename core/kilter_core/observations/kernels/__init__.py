"""Compiled search for rows that lie near each other."""
