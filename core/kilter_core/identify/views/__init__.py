"""Cameras of an identification, and the next views."""
