"""Signed messages of the stream: the master secret, sessions derived from it, and the bytes of a signed frame."""
