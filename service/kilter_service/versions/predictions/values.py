"""All values of a calibration in mm and degrees, with base and tool as whole frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kilter_core.parameters import display_unit_and_scale
from kilter_service.ground.core import transforms

if TYPE_CHECKING:
    from kilter_core.model import Calibration

FRAME = (("x", "mm"), ("y", "mm"), ("z", "mm"), ("rx", "deg"), ("ry", "deg"), ("rz", "deg"))


class Value(NamedTuple):
    """A number and its unit."""

    value: float
    unit: str


def wire_values(calibration: Calibration) -> dict[str, Value]:
    """Return every parameter by name; base and tool as x, y, z and rx, ry, rz (URDF) next to the nominal ones."""
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    out = {}
    for parameter, value in zip(model.parameters, values, strict=True):
        unit, scale = display_unit_and_scale(parameter.unit)
        out[parameter.name] = Value(float(value) * scale, unit)
    robot = calibration.robot
    for which, T, nominal in (("base", model.T_base, robot.T_base), ("tool", model.T_tool, robot.T_tool)):
        near = transforms.xyz_rpy_from_pose(np.asarray(nominal))[1]
        xyz, rpy = transforms.xyz_rpy_from_pose(np.asarray(T), near)
        numbers = [*(xyz * 1e3), *np.degrees(rpy)]
        out |= {f"{which}_{k}": Value(float(v), unit) for (k, unit), v in zip(FRAME, numbers, strict=True)}
    return out
