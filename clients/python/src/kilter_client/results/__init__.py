"""How answers are read, shown and turned into arrays."""
