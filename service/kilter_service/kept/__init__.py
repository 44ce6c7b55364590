"""What a reference means: a prefix, a name or `latest`; and what was purged."""
