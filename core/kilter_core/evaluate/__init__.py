"""How well a calibration predicts measurements, and ISO 9283's criteria."""

from kilter_core.evaluate.prediction import evaluate, expected_of, mean_errors, rows_of

__all__ = ["evaluate", "expected_of", "mean_errors", "rows_of"]
