"""Cases that somebody else hid: read, run through a server as a person would, and scored against the sealed truth."""
