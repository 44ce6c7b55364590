"""Choosing poses: ISO 9283's cube and diagonal planes, and what comes after it."""
