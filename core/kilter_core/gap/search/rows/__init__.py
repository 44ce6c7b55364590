"""Rows that are wrong, and what a search warns of in rows."""
