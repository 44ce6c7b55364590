"""Lengths and angles between the service, which counts in m and rad, and the wire, which counts in mm and degrees.

They take numbers and arrays. Figures and sentences use them too: no other module converts units.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from kilter_core.arm import Robot

T = TypeVar("T", float, "NDArray[np.float64]")

MM = 1e3  # in a metre
METRE = 1e-3  # in a millimetre
DEG = 180.0 / math.pi  # in a radian
RAD = math.pi / 180.0  # in a degree
MICROMETRE = 1e-6  # in a metre


def to_mm(metres: T) -> T:
    """Return a length in mm."""
    return metres * MM


def to_metres(millimetres: T) -> T:
    """Return a length in m."""
    return millimetres * METRE


def to_metres_if_known(millimetres: float | None) -> float | None:
    """Return a length in m, None where none is stated."""
    return None if millimetres is None else to_metres(millimetres)


def to_mm_if_known(metres: float | None) -> float | None:
    """Return a length in mm, None where it is not known."""
    return None if metres is None else to_mm(metres)


def from_um(micrometres: float) -> float:
    """Return a length in m, or what an error grows by per length."""
    return micrometres * MICROMETRE


def to_deg(radians: T) -> T:
    """Return an angle in degrees."""
    return radians * DEG


def to_rad(degrees: T) -> T:
    """Return an angle in rad."""
    return degrees * RAD


def joint_units(robot: Robot) -> list[str]:
    """Return the unit of each joint's reading: "deg", or "mm" of a prismatic one."""
    return ["mm" if joint.kind == "prismatic" else "deg" for joint in robot.joints]


def joint_scale(robot: Robot) -> list[float]:
    """Return what converts each joint's reading (rad or m) to that unit."""
    return [MM if unit == "mm" else DEG for unit in joint_units(robot)]


def joint_scale_back(robot: Robot) -> list[float]:
    """Return what converts each joint's reading in its unit to rad or m."""
    return [METRE if unit == "mm" else RAD for unit in joint_units(robot)]
