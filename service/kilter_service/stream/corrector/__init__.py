"""Corrected setpoints over zenoh: the stream, its process, the queries."""
