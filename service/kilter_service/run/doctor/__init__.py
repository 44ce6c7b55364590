"""What the server needs on its machine, checked before somebody misses it."""
