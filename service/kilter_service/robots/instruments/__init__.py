"""Instruments, their permissible errors and certificates."""
