"""Processes that the server starts and supervises: what they say, what they may use."""
