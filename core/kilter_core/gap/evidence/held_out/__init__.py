"""Errors at poses that took no part in the choice."""
