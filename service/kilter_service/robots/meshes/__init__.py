"""Shapes of a robot's links, for the picture of the arm."""
