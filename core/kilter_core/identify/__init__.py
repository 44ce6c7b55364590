"""Estimators and the identification that runs them: from observations to a calibration with its uncertainty."""

from kilter_core.identify.holdout import Folds
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.run import Identification, identify

__all__ = ["Folds", "Identification", "IdentifyOptions", "Prior", "identify"]
