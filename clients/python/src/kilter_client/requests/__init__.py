"""Requests to a server and what sends them: steps, connections, retries."""
