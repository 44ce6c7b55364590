"""Parameter versions in the formats of other tools."""
