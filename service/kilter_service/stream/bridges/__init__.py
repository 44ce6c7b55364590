"""Bridges: processes between a controller and its arm, which announce themselves."""
