"""What was measured, as arrays, and which rows are repeats of one pose."""

from kilter_core.observations.rows import CONDITIONS, Conditions, Observations

__all__ = ["CONDITIONS", "Conditions", "Observations"]
