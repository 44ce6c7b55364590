"""What is kept for people to find again: what a prefix, a name or `latest` refers to, and what was purged."""
