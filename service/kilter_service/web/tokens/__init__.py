"""Tokens: who may do what, with which robots, until when."""
