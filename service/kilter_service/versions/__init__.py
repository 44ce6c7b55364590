"""Immutable parameter versions and which one is active."""
