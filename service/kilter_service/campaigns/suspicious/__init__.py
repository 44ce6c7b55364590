"""Rows that look wrong, and who says so: the one list that every surface shows."""
