"""The kernels of the correction as one C99 file: the mathematics is written once, in Python, and translated."""
