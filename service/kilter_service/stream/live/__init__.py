"""Streams as people look at them while they run."""
