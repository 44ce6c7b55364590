"""Numbers and poses as attributes of URDF."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from kilter_core.types import Floats
from kilter_service.ground.core import transforms

CUT = -np.radians(179.0)


def set_origin(joint: Element, T: Floats) -> None:
    """Write a pose (4, 4) as the origin of a joint, with every digit that counts."""
    origin = joint.find("origin")
    origin = SubElement(joint, "origin") if origin is None else origin
    xyz, rpy = transforms.xyz_rpy_from_pose(T)
    origin.set("xyz", numbers(xyz))
    origin.attrib.pop("quat_xyzw", None)
    origin.set("rpy", numbers(away_from_the_cut(rpy)))


def away_from_the_cut(angles: Floats) -> Floats:
    """Angles (rad) from -179 to 181 degrees: drawings have 180 degrees often, whose sign rounding must not change."""
    return np.where(angles < CUT, angles + 2.0 * np.pi, angles)


def numbers(values: Floats) -> str:
    """Numbers as an attribute of URDF."""
    return " ".join(repr(float(value) + 0.0) for value in values)
