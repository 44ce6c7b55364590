"""Compiled pieces of the arm: poses, screws, loads, the chain rule. Flat numba functions over float64 arrays."""
