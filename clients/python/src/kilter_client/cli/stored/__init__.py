"""Commands of what is stored: campaigns, versions, instruments, their names and their end."""
