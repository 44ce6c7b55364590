"""The first view: all robots of the server."""
