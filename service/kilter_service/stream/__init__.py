"""Corrected setpoints: the processes that correct, signed sessions, bridges, the live view, ROS 2."""
