"""The audit: reading it, and whether it is whole."""
