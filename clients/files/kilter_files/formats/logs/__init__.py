"""Logs of single instruments: ball bars and inclinometers."""
