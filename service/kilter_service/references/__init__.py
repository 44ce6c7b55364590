"""Ids that a person can use: prefixes, names and `latest`; and what is left of what was purged."""
