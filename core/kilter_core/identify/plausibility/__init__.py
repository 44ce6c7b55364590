"""Whether observations belong to the robot: units, order, sign, orientation, numbering."""
