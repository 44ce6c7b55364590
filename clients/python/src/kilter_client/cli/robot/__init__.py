"""Commands that describe robots, and the pictures of an arm."""
