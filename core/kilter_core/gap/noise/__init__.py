"""Noise of a campaign from its repeats: visits, drift, covariances."""
