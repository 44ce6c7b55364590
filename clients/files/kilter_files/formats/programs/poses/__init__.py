"""Poses of robot programs: how they are written, in which frames, and which joints they mean."""
