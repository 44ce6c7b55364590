"""Texts that `make contract` writes."""
