"""What all rooms stand on: database, settings, errors, limits, tables of rows, names, what a correction says of its rows."""
