"""Joint logs: contract columns, ROS 2 bags, and the targets of programs."""
