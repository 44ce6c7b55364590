"""Ground: errors with place and remedy, units, numbers in cells, time stamps, and how a text is laid out."""
