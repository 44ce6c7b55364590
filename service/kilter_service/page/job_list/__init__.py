"""The jobs of the whole server."""
