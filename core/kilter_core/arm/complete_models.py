"""Complete models without redundancy: product of exponentials, CPC and MCPC, as chains of elementary transforms.

Two tilts and two shifts place a revolute axis after the one before, two tilts a prismatic axis, six numbers the flange: any
arm of R revolute and P prismatic joints is near 4 R + 2 P + 6 of them (Mooring, Roth and Driels 1991), and no pose is
described twice. Zero offsets of the joints say what later axes say together, so they are dependent parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kilter_core.arm.chain import Axis, Element
from kilter_core.transforms import align_z_axis, inverse, xyz_rpy_from_pose
from kilter_core.types import Floats

ORDER = ((Axis.TX, "x"), (Axis.TY, "y"), (Axis.TZ, "z"), (Axis.RX, "rx"), (Axis.RY, "ry"), (Axis.RZ, "rz"))


@dataclass(frozen=True)
class MovingAxis:
    """A line in the base frame at zero: ``direction (3,)`` unit, ``point (3,)`` m, and the joint that drives it."""

    direction: Floats
    point: Floats
    joint: int
    prismatic: bool = False
    ratio: float = 1.0
    drive: str | None = None


@dataclass(frozen=True)
class Place:
    """Where an axis is after the one before: a structural pose, then Rx(alpha) Ry(beta) Tx(x) Ty(y); its joint's zero."""

    alpha: float
    beta: float
    x: float
    y: float
    offset: float = 0.0
    prismatic: bool = False
    before: Floats = field(default_factory=lambda: np.eye(4))


def poe_elements(axes: Sequence[MovingAxis], home: Floats) -> tuple[Element, ...]:
    """Product of exponentials: axes as lines at zero, and the pose ``home (4, 4)`` of the flange there.

    The errors are local (Chen, Yang, Tan and Yeo 1999): each axis is tilted and shifted in a frame on it, and what
    follows moves with it.
    """
    elements: list[Element] = []
    frame, led = np.eye(4), set[int]()
    for k, axis in enumerate(axes, 1):
        stands = np.eye(4)
        stands[:3, :3], stands[:3, 3] = align_z_axis(frame[:3, :3], axis.direction), axis.point
        place = Place(0.0, 0.0, 0.0, 0.0, prismatic=axis.prismatic, before=inverse(frame) @ stands)
        leads = axis.joint not in led
        led.add(axis.joint)
        elements += [
            *_placement_elements(k, place, ("tilt_x", "tilt_y", "shift_x", "shift_y")),
            _joint(k, place, axis, leads),
        ]
        frame = stands
    return (*elements, *_flange(inverse(frame) @ home))


def cpc_elements(places: Sequence[Place], flange: Floats) -> tuple[Element, ...]:
    """Complete and parametrically continuous model of Zhuang, Roth and Hamano (1992): the direction b of the next axis in
    the frame before (in ``Place.before``), then Tx(x) Ty(y). Errors of b are two tilts about its own frame.
    """
    return _by_places(places, flange, ("tilt_x", "tilt_y", "x", "y"))


def mcpc_elements(places: Sequence[Place], flange: Floats) -> tuple[Element, ...]:
    """Modified CPC model of Zhuang, Wang and Roth (1993): Rx(alpha) Ry(beta) Tx(x) Ty(y), then the joint."""
    return _by_places(places, flange, ("alpha", "beta", "x", "y"))


def rotation_to(b: Floats) -> Floats:
    """Pose (4, 4) that rotates z to the unit vector ``b (3,)`` by the smallest angle; to -z about y."""
    across = float(np.hypot(b[0], b[1]))
    c, s = (b[0] / across, b[1] / across) if across > 0.0 else (1.0, 0.0)
    # Rz(phi) Ry(theta) Rz(-phi): the usual closed form loses half the digits near -z.
    about, out = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.eye(4)
    lean = np.array([[b[2], 0.0, across], [0.0, 1.0, 0.0], [-across, 0.0, b[2]]])
    out[:3, :3] = about @ lean @ about.T
    return out


def _by_places(places: Sequence[Place], flange: Floats, names: tuple[str, str, str, str]) -> tuple[Element, ...]:
    elements: list[Element] = []
    for k, place in enumerate(places, 1):
        axis = MovingAxis(np.zeros(3), np.zeros(3), k - 1, place.prismatic)
        elements += [*_placement_elements(k, place, names), _joint(k, place, axis, leads=True)]
        if place.prismatic and place.offset:
            elements.append(Element(Axis.RZ, place.offset))
    return (*elements, *_flange(flange))


def _placement_elements(k: int, place: Place, names: tuple[str, str, str, str]) -> list[Element]:
    """Elements up to a joint. A prismatic axis has no place across itself: its shifts are structure."""
    four = zip((Axis.RX, Axis.RY, Axis.TX, Axis.TY), (place.alpha, place.beta, place.x, place.y), names, strict=True)
    made = _structure(place.before)
    for axis, value, name in four:
        if axis.rotates or not place.prismatic:
            made.append(Element(axis, value, f"{name}_{k}"))
        elif value:
            made.append(Element(axis, value))
    return made


def _joint(k: int, place: Place, axis: MovingAxis, leads: bool) -> Element:
    if axis.prismatic:
        name = f"d_offset_{k}" if leads else None
        return Element(Axis.TZ, 0.0, name, axis.joint, axis.ratio, dependent=True, drive=axis.drive)
    name = f"theta_offset_{k}" if leads else None
    return Element(Axis.RZ, place.offset, name, axis.joint, axis.ratio, dependent=True, drive=axis.drive)


def _flange(T: Floats) -> list[Element]:
    """The flange, and six small increments in its own frame: no angle of it is ever singular."""
    return [*_structure(T), *(Element(axis, 0.0, f"flange_{name}") for axis, name in ORDER)]


def _structure(T: Floats) -> list[Element]:
    xyz, rpy = xyz_rpy_from_pose(T)
    steps = [
        *zip((Axis.TX, Axis.TY, Axis.TZ), xyz, strict=True),
        (Axis.RZ, rpy[2]),
        (Axis.RY, rpy[1]),
        (Axis.RX, rpy[0]),
    ]
    return [Element(axis, float(value)) for axis, value in steps if value != 0.0]
