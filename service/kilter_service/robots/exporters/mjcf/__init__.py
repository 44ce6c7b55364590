"""A version as a model of MuJoCo: an arm that sags, has backlash and sticks as the real one does."""
