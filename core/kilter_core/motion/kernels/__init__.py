"""Compiled steps of a joint in time."""
