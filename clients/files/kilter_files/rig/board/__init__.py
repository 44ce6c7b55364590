"""Boards that a camera sees: printed in true mm."""
