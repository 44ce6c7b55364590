"""The pencil sheet of the low-cost rig: printed, drawn on by the robot, scanned, and read back in mm."""
