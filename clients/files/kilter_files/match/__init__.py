"""Two devices joined: clocks, jumps, knocked markers, and which joints go with which rows."""
