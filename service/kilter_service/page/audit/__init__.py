"""Who changed what, and whether that record is whole."""
