"""Estimators and the identification that runs them: from observations to a calibration with its uncertainty."""

from core.identify.holdout import Folds
from core.identify.kalman import Prior
from core.identify.options import IdentifyOptions
from core.identify.run import Identification, identify

__all__ = ["Folds", "Identification", "IdentifyOptions", "Prior", "identify"]
