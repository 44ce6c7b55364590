"""Backups of the database while it is in use, their restoration, and the check of every hash."""
