"""How well a calibration predicts measurements, and ISO 9283's criteria."""

from kilter_core.evaluate.prediction import errors_by_row, evaluate, expected_error_half_widths, mean_errors

__all__ = ["errors_by_row", "evaluate", "expected_error_half_widths", "mean_errors"]
