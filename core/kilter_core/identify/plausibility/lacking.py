"""One fixed transform that the description of an arm lacks between two joints: another drawing, not other rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from kilter_core.arm.conversions.screws import chain_frames, screws_of_chain
from kilter_core.identify.plausibility.placed import Sample, place
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import inverse, left_jacobian, rotation_exp, rotation_log, scipy_rotation, skew
from kilter_core.types import Floats

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
