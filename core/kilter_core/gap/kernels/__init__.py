"""Compiled loops of the gap finder: numba functions, flat arrays in and out."""
