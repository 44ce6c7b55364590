"""What goes over the wire, written once: pydantic models of every request and answer. Knows pydantic and itself only."""
