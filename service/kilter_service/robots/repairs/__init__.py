"""What was done to arms: from a repair on an arm is another one for its checks."""
