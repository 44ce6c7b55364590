"""Recordings of markers: C3D, NDI floating point, and text."""
