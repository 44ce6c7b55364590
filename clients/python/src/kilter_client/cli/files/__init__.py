"""Commands that read files and send their rows."""
