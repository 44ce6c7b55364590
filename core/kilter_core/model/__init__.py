"""The robot model: chain, effects and frames together; poses, exact Jacobian, calibrations."""

from kilter_core.model.calibration import Calibration
from kilter_core.model.prediction import Prediction
from kilter_core.model.robot_model import RobotModel

__all__ = ["Calibration", "Prediction", "RobotModel"]
