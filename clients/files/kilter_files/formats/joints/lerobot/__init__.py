"""LeRobot's files: the calibration of an arm's servos, and data sets as joint logs."""
