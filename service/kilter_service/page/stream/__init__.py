"""The stream of a robot while it runs."""
