"""The only compiled code: flat numba functions over float64 arrays. Each file calls only its own helpers."""
