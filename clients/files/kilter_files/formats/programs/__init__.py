"""Programs of robots: joint targets at their places, for a list of joints or to be rewritten."""
