"""What can be measured of an arm, one kind per file: residuals against a prediction, their Jacobian, unit and noise."""

from kilter_core.measurement.kind import Block, Residual
from kilter_core.measurement.rows import Measurement

__all__ = ["Block", "Measurement", "Residual"]
