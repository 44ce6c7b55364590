"""Corrected trajectories over HTTP."""
