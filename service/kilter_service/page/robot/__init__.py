"""One robot: how good it is, what corrects it, and the arm in 3-D."""
