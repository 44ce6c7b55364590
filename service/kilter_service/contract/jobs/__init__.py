"""Jobs over the wire, a file per kind."""
