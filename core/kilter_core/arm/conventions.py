"""Chains of elementary transforms from rows of a convention: DH, modified DH, Hayati; and complete models without redundancy.

Two tilts and two shifts place a revolute axis after the one before, two tilts a prismatic axis, six numbers the flange: any
arm of R revolute and P prismatic joints is near 4 R + 2 P + 6 of them (Mooring, Roth and Driels 1991), and no pose is
described twice. Zero offsets of the joints say what later axes say together, so they are dependent parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kilter_core.arm.chain import Axis, Element
from kilter_core.transforms import align_z_axis, inverse, xyz_rpy_from_pose
from kilter_core.types import Floats

PARALLEL_RAD = math.radians(1.0)  # axes nearer to parallel than this need Hayati's rotation to stay identifiable


@dataclass(frozen=True)
class Row:
    """One row of a DH, MDH or Hayati table, SI. ``beta`` and ``d`` are None where the convention has none."""

    alpha: float
    a: float
    theta_offset: float = 0.0
    d: float | None = 0.0
    beta: float | None = None
    prismatic: bool = False
    gamma: float = 0.0  # S-model only: rotation and shift along the next axis
    b: float = 0.0


def _joint(i: int, row: Row) -> tuple[Element, Element | None]:
    """Return the joint element of row i and the constant partner along the same axis."""
    if row.prismatic:
        return (
            Element(Axis.TZ, row.d or 0.0, f"d_{i + 1}", joint=i),
            Element(Axis.RZ, row.theta_offset, f"theta_offset_{i + 1}"),
        )
    partner = None if row.d is None else Element(Axis.TZ, row.d, f"d_{i + 1}")
    return Element(Axis.RZ, row.theta_offset, f"theta_offset_{i + 1}", joint=i), partner


def _beta(i: int, row: Row, parallel: bool) -> list[Element]:
    """Hayati's rotation about y: as the table says, or added with value 0 where two axes are almost parallel."""
    if row.beta is not None or parallel:
        return [Element(Axis.RY, row.beta or 0.0, f"beta_{i + 1}")]
    return []


def _parallel(alpha: float) -> bool:
    return abs(math.sin(alpha)) < math.sin(PARALLEL_RAD)


def dh_elements(rows: Sequence[Row]) -> tuple[tuple[Element, ...], tuple[int, ...]]:
    """Standard DH, thesis eq. 2.1: Tz(d) Rz(θ) Tx(a) Rx(α) per row.

    Where row i and i+1 rotate about almost parallel axes a rotation Ry(β) of value 0 is added after Rx(α): DH alone is
    singular there (Hayati and Mirmirani 1985). Returns the elements and, per row, the index of the row's frame.
    """
    elements: list[Element] = []
    frames = []
    for i, row in enumerate(rows):
        elements += _dh_row(i, row, last=i + 1 == len(rows))
        frames.append(len(elements) - 1)
    return tuple(elements), tuple(frames)


def _dh_row(i: int, row: Row, *, last: bool) -> list[Element]:
    joint, partner = _joint(i, row)
    ordered = [joint, partner] if row.prismatic else [partner, joint]
    made = [e for e in ordered if e is not None]
    made += [Element(Axis.TX, row.a, f"a_{i + 1}"), Element(Axis.RX, row.alpha, f"alpha_{i + 1}")]
    return made + _beta(i, row, _parallel(row.alpha) and not last)


def s_model_elements(rows: Sequence[Row]) -> tuple[tuple[Element, ...], tuple[int, ...]]:
    """Stone's S-model: Tz(d) Rz(θ) Tx(a) Rx(α) Rz(γ) Tz(b) per row, so that a frame may be anywhere on its axis.

    γ and b say what θ and d of the next row say, so they are parameters in the last row only, which with them places the
    flange freely. Returns the elements and, per row, the index of the row's frame.
    """
    elements: list[Element] = []
    frames = []
    for i, row in enumerate(rows):
        last = i + 1 == len(rows)
        elements += _dh_row(i, row, last=last)
        elements.append(Element(Axis.RZ, row.gamma, f"gamma_{i + 1}" if last else None))
        elements.append(Element(Axis.TZ, row.b, f"b_{i + 1}" if last else None))
        frames.append(len(elements) - 1)
    return tuple(elements), tuple(frames)


def mdh_elements(rows: Sequence[Row]) -> tuple[tuple[Element, ...], tuple[int, ...]]:
    """Craig's MDH, thesis eq. 2.4 corrected: Rx(α) [Ry(β)] Tx(a) Rz(θ) Tz(d) per row, α, a, β being those of i-1.

    A row with β is Hayati's (eq. 3.2 corrected). Returns the elements and, per row, the index of the row's frame.
    """
    elements: list[Element] = []
    frames = []
    for i, row in enumerate(rows):
        elements.append(Element(Axis.RX, row.alpha, f"alpha_{i + 1}"))
        elements += _beta(i, row, _parallel(row.alpha) and i > 0)
        elements.append(Element(Axis.TX, row.a, f"a_{i + 1}"))
        joint, partner = _joint(i, row)
        elements += [e for e in (joint, partner) if e is not None]
        frames.append(len(elements) - 1)
    return tuple(elements), tuple(frames)


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
            _joint_complete_models(k, place, axis, leads),
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
        elements += [*_placement_elements(k, place, names), _joint_complete_models(k, place, axis, leads=True)]
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


def _joint_complete_models(k: int, place: Place, axis: MovingAxis, leads: bool) -> Element:
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
