"""Numbers and poses as attributes of URDF."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from kilter_core.transforms import xyz_rpy_from_pose

Floats = NDArray[np.float64]


def set_origin(joint: Element, T: Floats) -> None:
    """Write a pose (4, 4) as the origin of a joint, with every digit that counts."""
    origin = joint.find("origin")
    origin = SubElement(joint, "origin") if origin is None else origin
    xyz, rpy = xyz_rpy_from_pose(T)
    origin.set("xyz", numbers(xyz))
    origin.set("rpy", numbers(rpy))


def numbers(values: Floats) -> str:
    """Numbers as an attribute of URDF."""
    return " ".join(repr(float(value) + 0.0) for value in values)
