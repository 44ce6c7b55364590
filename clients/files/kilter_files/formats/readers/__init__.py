"""What each reader states, one in a file: which files it recognises, how it describes one, and how it reads it."""
