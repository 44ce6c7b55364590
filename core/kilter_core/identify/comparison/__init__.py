"""Models and calibrations against each other."""
