"""Compiled correction of setpoints. Flat numba functions over float64 arrays."""
