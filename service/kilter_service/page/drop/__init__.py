"""A dropped file: what is understood of it, the column map, and storing it as a campaign."""
