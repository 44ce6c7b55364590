"""The campaigns of a robot, and what one of them holds."""
