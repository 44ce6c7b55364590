"""Corrected setpoints for ROS 2, a process of its own beside the corrector."""
