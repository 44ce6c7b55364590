"""What several views say: how accurate a version is, what corrects a robot, what was measured, and jobs in lists."""
