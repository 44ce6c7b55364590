"""Whether what was identified is still the arm that is described: distances and angles of consecutive axes.

A fit with enough freedom makes one arm of another: rows of a robot of 0.9 m on a preset of 1.3 m were fitted to 0.05 mm, with
a link longer by 52 mm and an axis rotated by 90 degrees. What is compared does not depend on how the arm is described, and
no zero of a joint enters it: a joint that was mastered wrong is the same arm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.model import Calibration
from kilter_core.parameters import ANGLE_PRIOR_RAD, LENGTH_PRIOR_M, display_unit_and_scale
from kilter_core.types import Floats

CODE = "another_arm"
MANY = 4.0  # prior sigmas: 20 mm and 4.6 degrees. Arms are made to a tenth of that, home-made ones to a third
PARALLEL = 0.17  # sine of the angle below which the common normal of two axes has no sure place
NAMED = 4  # differences in a sentence, the largest first


@dataclass(frozen=True)
class Difference:
    """How far apart two axes, or the ends of their common normals, are as described and as found, m or rad."""

    what: str
    nominal: float
    found: float
    turns: bool

    @property
    def sigmas(self) -> float:
        """The change in prior sigmas."""
        return abs(self.found - self.nominal) / (ANGLE_PRIOR_RAD if self.turns else LENGTH_PRIOR_M)

    @property
    def sentence(self) -> str:
        """In words, mm and degrees."""
        scale, unit = display_unit_and_scale("rad" if self.turns else "m")[::-1]
        return f"{self.what}: {self.nominal * scale:.4g} {unit} as described, {self.found * scale:.4g} {unit} as found"


def differences(calibration: Calibration) -> list[Difference]:
    """Angle and distance of each two consecutive axes, and the lengths between them along each axis."""
    nominal, found = (_axes(c) for c in (Calibration.nominal(calibration.robot), calibration))
    turns = [e.axis.rotates for e in _driven(calibration)]
    out = []
    for k in range(len(turns) - 1):
        pair = f"axes {k + 1} and {k + 2}"
        out.append(Difference(f"angle of {pair}", _angle(nominal, k), _angle(found, k), turns=True))
        if turns[k] and turns[k + 1]:
            along = _sine(nominal, k) < PARALLEL
            lengths = _distance(nominal, k, along), _distance(found, k, along)
            out.append(Difference(f"distance of {pair}", *lengths, turns=False))
    inner = range(1, len(turns) - 1)
    sure = [
        k
        for k in inner
        if all(turns[k - 1 : k + 2]) and _is_far_from_parallel(nominal, k) and _is_far_from_parallel(found, k)
    ]
    ends = [Difference(f"length along axis {k + 1}", _along(nominal, k), _along(found, k), turns=False) for k in sure]
    return [*out, *ends]


def another_arm(calibration: Calibration) -> Iterator[dict[str, Any]]:
    """Warn that the arm found is not the arm described, with what differs most; nothing where it may be the same."""
    with np.errstate(all="ignore"):  # of nonsense: what is not a number is not near nominal either
        many = sorted((d for d in differences(calibration) if not d.sigmas <= MANY), key=lambda d: -d.sigmas)
    if many:
        more = f", and {len(many) - NAMED} more" if len(many) > NAMED else ""
        yield {
            "code": CODE,
            "sigmas": many[0].sigmas,
            "message": f"This is not the arm described: {'; '.join(d.sentence for d in many[:NAMED])}{more}. No arm is made so "
            "far off its drawing: do not activate this version. Register the robot that was measured (another preset, or its "
            "URDF or table), or correct its description, and identify again.",
        }


def _driven(calibration: Calibration) -> list[Any]:
    chain = calibration.robot.chain
    return [chain.elements[k] for k in sorted(chain.primary)]


def _axes(calibration: Calibration) -> tuple[Floats, Floats]:
    """A point (n, 3) m and the direction (n, 3) of each axis, all joints at zero, from the base on."""
    chain = calibration.robot.chain
    values = dict(zip(calibration.names, calibration.values, strict=True))
    T, points, directions, primary = np.eye(4), [], [], set(chain.primary)
    for k, e in enumerate(chain.elements):
        if k in primary:
            points.append(T[:3, 3].copy())
            directions.append(T[:3, e.axis % 3].copy())
        T = T @ e.axis.motion(float(values.get(e.name, e.value)) if e.name else e.value)
    return np.array(points), np.array(directions)


def _sine(axes: tuple[Floats, Floats], k: int) -> float:
    return float(np.linalg.norm(np.cross(axes[1][k], axes[1][k + 1])))


def _is_far_from_parallel(axes: tuple[Floats, Floats], k: int) -> bool:
    """Whether an axis is far from parallel to both its neighbours."""
    return min(_sine(axes, k - 1), _sine(axes, k)) > PARALLEL


def _angle(axes: tuple[Floats, Floats], k: int) -> float:
    """Angle of two axes from 0 to a right angle: which way an axis counts is the sign of its joint."""
    return float(np.arctan2(_sine(axes, k), abs(axes[1][k] @ axes[1][k + 1])))


def _distance(axes: tuple[Floats, Floats], k: int, parallel: bool) -> float:
    """Distance m of two axes; of parallel ones at the origin of the later joint."""
    points, directions = axes
    between = points[k + 1] - points[k]
    if parallel or _sine(axes, k) < PARALLEL:
        return float(np.linalg.norm(between - (between @ directions[k]) * directions[k]))
    normal = np.cross(directions[k], directions[k + 1])
    return float(abs(between @ normal) / np.linalg.norm(normal))


def _along(axes: tuple[Floats, Floats], k: int) -> float:
    """Length m along an axis between the ends of its common normals with the axes before and after it."""
    return abs(_foot(axes, k, k + 1) - _foot(axes, k, k - 1))


def _foot(axes: tuple[Floats, Floats], k: int, other: int) -> float:
    """Where on axis ``k`` its common normal with another axis stands, m from its own point."""
    points, directions = axes
    between, dot = points[other] - points[k], directions[k] @ directions[other]
    return float((between @ directions[k] - dot * (between @ directions[other])) / (1.0 - dot**2))
