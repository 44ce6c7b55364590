"""Ids that a person can use: prefixes, names and `latest`; what cites a campaign; what is left of what was purged."""
