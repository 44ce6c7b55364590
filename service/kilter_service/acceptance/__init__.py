"""Decisions about a tolerance."""
