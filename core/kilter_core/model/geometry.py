"""The geometric part of a calibration as an arm of its own, in the robot's base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.conversions.tables import Screws, chain_frames, screws_of_chain
from kilter_core.model import Calibration, RobotModel
from kilter_core.transforms import inverse
from kilter_core.types import Floats


@dataclass(frozen=True)
class FlangeFrames:
    """``elements (E + 1, 4, 4)``: poses of the identified chain at zero, before the first and after each element, in the
    robot's base frame; ``end (4, 4)`` from the last to the identified flange.
    """

    elements: Floats
    end: Floats


def arm_screws(calibration: Calibration) -> Screws:
    """Base to tool point: the identified chain between the identified frames, seen from the wanted base.

    What the wanted and the identified frames differ by is part of the arm's error, so it stays in the arm.
    """
    model, constants = _absorb_frames(calibration)
    return screws_of_chain(model.robot.chain, constants).compose_with_poses(
        _base_in_wanted_frame(calibration, model), np.asarray(model.T_tool)
    )


def flange_screws(calibration: Calibration) -> Screws:
    """Base to flange: a drop-in for the nominal chain; with the controller's tool frame behind it, the tool is right."""
    return arm_screws(calibration).compose_with_poses(np.eye(4), inverse(wanted_tool(calibration)))


def flange_frames(calibration: Calibration) -> FlangeFrames:
    """The same arm, element by element."""
    model, constants = _absorb_frames(calibration)
    elements = _base_in_wanted_frame(calibration, model) @ chain_frames(model.robot.chain, constants)
    return FlangeFrames(elements, np.asarray(model.T_tool) @ inverse(wanted_tool(calibration)))


def wanted_tool(calibration: Calibration) -> Floats:
    """The tool frame (4, 4) that the controller has."""
    return np.asarray(calibration.nominal_in_wanted_frames().model.T_tool)


def _absorb_frames(calibration: Calibration) -> tuple[RobotModel, Floats]:
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    return model, values[6 : model.n_geometric - 6]


def _base_in_wanted_frame(calibration: Calibration, model: RobotModel) -> Floats:
    return np.asarray(
        inverse(np.asarray(calibration.nominal_in_wanted_frames().model.T_base)) @ np.asarray(model.T_base)
    )
