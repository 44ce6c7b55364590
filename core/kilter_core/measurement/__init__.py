"""What can be measured of an arm, one kind per file: residuals against a prediction, their Jacobian, unit and noise."""

from kilter_core.measurement.tool import Measurement, Residual

__all__ = ["Measurement", "Residual"]
