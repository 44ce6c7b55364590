"""Whether a reading of the rows can be true, whether this is still the arm described, and what its description lacks.

A fit with enough freedom makes one arm of another: rows of a robot of 0.9 m on a preset of 1.3 m were fitted to 0.05 mm, with
a link longer by 52 mm and an axis rotated by 90 degrees. What is compared does not depend on how the arm is described, and
no zero of a joint enters it: a joint that was mastered wrong is the same arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from kilter_core.arm.conversions.tables import chain_frames, screws_of_chain
from kilter_core.arm.robot import Robot
from kilter_core.errors import FindingDocument
from kilter_core.identify.plausibility.mix_ups import MixUp
from kilter_core.identify.plausibility.set_up_changes import Sample, place
from kilter_core.model import Calibration
from kilter_core.parameters import ANGLE_PRIOR_RAD, LENGTH_PRIOR_M, degrees, display_unit_and_scale, mm
from kilter_core.transforms import inverse, left_jacobian, rotation_exp, rotation_log, scipy_rotation, skew
from kilter_core.types import Floats

LONGEST_TOOL = 2.0  # reaches; a small arm may carry a long rod,
LEAST_TOOL_M = 1.0
TOLD = 0.2  # share of the length that tells a unit: more must be missing before, less may be missing after
BEYOND = 0.1  # share of its range by which a joint may be outside its limits
TURNS = 4.0 * np.pi  # where a joint has no limits
WITHIN = 0.95  # share of the rows


def reach(robot: Robot) -> float:
    """How far (m) the tool point can be from the base: all lengths of the arm in a row."""
    lengths = sum(abs(e.value) for e in robot.chain.elements if not e.axis.rotates)
    ends = [abs(end) for j in robot.joints if j.kind == "prismatic" for end in (j.lower, j.upper)]
    strokes = sum(max(pair) for pair in zip(ends[::2], ends[1::2], strict=True) if np.isfinite(pair).all())
    return float(lengths + strokes + np.linalg.norm(robot.T_tool[:3, 3]))


def believable(sample: Sample, mixed: Sequence[MixUp], read: Sample) -> bool:
    """Whether the rows of ``sample`` can be what ``read`` has after these mix-ups."""
    robot = sample.begin.robot
    if np.linalg.norm(read.fitted_placement.tool) > max(LONGEST_TOOL * reach(robot), LEAST_TOOL_M):
        return False
    units = [m.factor for m in mixed if m.of_units and m.factor is not None]
    if units and not _within_limits(robot, read):
        return False
    # Readings that a larger unit makes smaller are beyond the limits as they are: else it only makes a joint stand still.
    if any(np.min(factor) < 1.0 for factor in units) and _within_limits(robot, sample):
        return False
    factor = float(np.prod([m.length for m in mixed]))
    return factor == 1.0 or _tells(sample, read, factor)


def _tells(sample: Sample, read: Sample, factor: float) -> bool:
    """Whether another unit of the points would be seen as it is seen here.

    A tool of any length takes up the unit of a point that moves on a sphere; only what the chain's own lengths move can
    tell, and what is missing as the rows are must be of the size that the other unit makes of it.
    """
    missing = TOLD * read.lengths * abs(1.0 / factor - 1.0)
    return sample.fitted_placement.size > missing and read.fitted_placement.size < TOLD * read.lengths


def _within_limits(robot: Robot, read: Sample) -> bool:
    """Whether the joints can have been where a reading in another unit puts them."""
    low, high = robot.limits.T
    slack = np.where(np.isfinite(high - low), BEYOND * (high - low), 0.0)
    bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(bounded, low - slack, -TURNS), np.where(bounded, high + slack, TURNS)
    revolute = np.array([j.kind == "revolute" for j in robot.joints])
    inside = ((read.q >= low) & (read.q <= high)) | ~(revolute | bounded)
    return bool(np.mean(inside.all(axis=1)) >= WITHIN)


REFINED = 3  # starts of each link from which the transform is fitted
ALIKE = 1.2  # times the least: starts that leave so little say the same in other words
SURELY = 0.8  # times what another transform leaves: a better one
ENOUGH = 0.05  # share of what is left without: no better transform is looked for
RIDGE = 1e-3  # m per m and rad: what base, tool and zeros say as well stays with them
EVALUATIONS = 300
SETTLED = 1e-6  # share of the squares by which a last step lowers them: sizes are compared to a tenth
STRAIGHT_RAD = np.radians(3.0)  # an axis that is so near x, y or z is called so, a smaller rotation is not named
SHORT = 0.02  # share of the workspace: a shorter shift is not named beside a rotation


@dataclass(frozen=True)
class Lacking:
    """A transform in words, and rms m that base and tool leave with it."""

    words: str
    left: float


@dataclass(frozen=True)
class Link:
    """The link behind joint ``number``: poses (K, 4, 4) of its frame after that joint, and of its end (4, 4) in that frame."""

    number: int
    poses: Floats
    end: Floats

    def flange(self, flange: Floats, transform: Floats) -> Floats:
        """Flange poses (K, 4, 4) with one transform (4, 4) more in the link."""
        return np.asarray(self.poses @ transform @ np.linalg.inv(self.poses) @ flange)


def find_lacking(sample: Sample) -> Lacking:
    """The one transform more between two joints with which base and tool leave least of the points."""
    best = Lacking("", sample.fitted_placement.size)
    for link in _links(sample):
        for start in _starts(sample, link):
            transform = _fit_transform(sample, link, start)
            size = _placed_size(sample, link, transform)
            if size < SURELY * best.left:  # of transforms that say the same the least rotation comes first
                best = Lacking(_describe(link, transform, SHORT * sample.spread), size)
        if best.left < ENOUGH * sample.fitted_placement.size:
            break
    return best


def _starts(sample: Sample, link: Link) -> list[Floats]:
    """No rotation, and the quarter rotations from which least is left; the smallest first."""
    rotations = _quarter_rotations()
    sizes = np.array([_placed_size(sample, link, start) for start in rotations])
    best = set(np.argsort(sizes)[:REFINED]) | set(np.flatnonzero(sizes < ALIKE * sizes.min())[:REFINED])
    return [rotations[k] for k in sorted(best | {0})]


def _links(sample: Sample) -> Iterator[Link]:
    """The links between two joints, of the nominal arm."""
    chain = sample.begin.robot.chain
    frames, screws = chain_frames(chain), screws_of_chain(chain)
    moving = [k for k, e in enumerate(chain.elements) if e.joint is not None]
    carried = list(screws.link_motions(sample.q))
    for axis, (k, following) in enumerate(pairwise(moving)):
        after = frames[k + 1]
        yield Link(int(screws.joint[axis]) + 1, carried[axis + 1] @ after, inverse(after) @ frames[following])


@cache
def _quarter_rotations() -> Floats:
    """The 24 rotations by quarter rotations as poses (24, 4, 4), the smallest first."""
    poses = np.tile(np.eye(4), (24, 1, 1))
    group = scipy_rotation().create_group("O")
    poses[:, :3, :3] = group.as_matrix()[np.argsort(np.round(group.magnitude(), 6), kind="stable")]
    return poses


def _placed_size(sample: Sample, link: Link, transform: Floats) -> float:
    return place(link.flange(sample.flange, transform), sample.points).size


def _fit_transform(sample: Sample, link: Link, start: Floats) -> Floats:
    """The transform (4, 4) near ``start`` that with base and tool leaves least of the points."""
    placed = place(link.flange(sample.flange, start), sample.points)
    begin = np.concatenate([np.zeros(6), rotation_log(placed.rotation[None])[0], placed.place, placed.tool])
    flange = np.linalg.inv(link.poses) @ sample.flange
    after = link.poses @ start

    def chain(x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Rotations of transform and base, and the points (K, 3) before the transform and before the base."""
        turned, base = rotation_exp(x[:3]), rotation_exp(x[6:9])
        before = flange[:, :3, 3] + flange[:, :3, :3] @ x[12:]
        moved = np.einsum("kij,kj->ki", after[:, :3, :3], before @ turned.T + x[3:6]) + after[:, :3, 3]
        return turned, base, before, moved

    def residual_vector(x: Floats) -> Floats:
        _, base, _, moved = chain(x)
        return np.concatenate([(moved @ base.T + x[9:12] - sample.points).reshape(-1), RIDGE * x[:6]])

    def slopes(x: Floats) -> Floats:
        turned, base, before, moved = chain(x)
        carried = base @ after[:, :3, :3]
        J = np.zeros((len(before), 3, 15))
        J[:, :, :3] = -carried @ turned @ skew(before) @ left_jacobian(x[:3]).T
        J[:, :, 3:6] = carried
        J[:, :, 6:9] = -base @ skew(moved) @ left_jacobian(x[6:9]).T
        J[:, :, 9:12] = np.eye(3)
        J[:, :, 12:] = carried @ turned @ flange[:, :3, :3]
        return np.vstack([J.reshape(-1, 15), np.eye(6, 15) * RIDGE])

    from scipy.optimize import least_squares  # 15 MB, which the API does without

    found = least_squares(residual_vector, begin, slopes, method="lm", ftol=SETTLED, max_nfev=EVALUATIONS)
    return np.asarray(start @ _pose(found.x[:6]))


def _pose(x: Floats) -> Floats:
    """Pose (4, 4) of a rotation vector and a place."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation_exp(x[:3]), x[3:]
    return out


def _describe(link: Link, transform: Floats, short: float) -> str:
    """The transform in words, at its beginning unless it clearly shifts less at its end."""
    after, before = transform, inverse(link.end) @ transform @ link.end
    at_end = float(np.linalg.norm(before[:3, 3])) + short < float(np.linalg.norm(after[:3, 3]))
    found, where = (before, f"before joint {link.number + 1}") if at_end else (after, f"after joint {link.number}")
    parts = []
    about, shift = rotation_log(found[None, :3, :3])[0], found[:3, 3]
    angle = float(np.linalg.norm(about))
    if angle > STRAIGHT_RAD:
        parts.append(f"a rotation of {degrees(angle):.0f} degrees about {_axis(about / angle)}")
    if not parts or np.linalg.norm(shift) > short:
        parts.append(f"a shift of ({', '.join(f'{mm(v):.0f}' for v in shift)}) mm")
    return f"{' and '.join(parts)} right {where}"


def _axis(axis: Floats) -> str:
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) < np.cos(STRAIGHT_RAD):
        return f"({', '.join(f'{v:.2f}' for v in axis)})"
    return f"{'-' if axis[k] < 0 else ''}{'xyz'[k]}"


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


def another_arm(calibration: Calibration) -> Iterator[FindingDocument]:
    """Warn that the arm found is not the arm described, with what differs most; nothing where it may be the same."""
    with np.errstate(all="ignore"):  # of nonsense: what is not a number is not near nominal either
        many = sorted((d for d in differences(calibration) if not d.sigmas <= MANY), key=lambda d: -d.sigmas)
    if many:
        more = f", and {len(many) - NAMED} more" if len(many) > NAMED else ""
        yield FindingDocument.make(
            CODE,
            f"This is not the arm described: {'; '.join(d.sentence for d in many[:NAMED])}{more}. No arm is made so "
            "far off its drawing: do not activate this version. Register the robot that was measured (another preset, or its "
            "URDF or table), or correct its description, and identify again.",
            sigmas=many[0].sigmas,
        )


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
