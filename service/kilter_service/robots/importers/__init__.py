"""Robot descriptions of other tools."""
