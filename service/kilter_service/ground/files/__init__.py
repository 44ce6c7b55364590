"""Files of the server: private, hashed, beside it, and the folder of backups."""
