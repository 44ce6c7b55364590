"""Where a version that a search made is less sure than it says: near what was set aside, and everywhere if it is not closed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator, on_rows
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit
from kilter_core.gap.search.linear.in_space import cholesky_root
from kilter_core.gap.search.sources.source import Source
from kilter_core.model.doubts import Doubt
from kilter_core.types import Bools, Floats

# Half of a box about a pose that was set aside, rad and m: a local error of a gear or an encoder is up to as wide, and the
# visit does not tell on which side of it it lies.
NEAR_RAD, NEAR_M = np.radians(10.0), 0.05
BY_NOISE = 0.001  # chance that noise leaves so much of an error beside the motion of the joint that made it
LEVER = 0.2  # of a joint's longest: with less it would have to err by far more than this to make the error
NEAR = "a pose near these was set aside as a wrong reading. Measure it again; what errs there again is the arm."
NOT_CLOSED = "its search leaves an error that no known effect explains."


class Aside(NamedTuple):
    """A visit that was set aside: its joints (n,), its error m, and joints that may have made it, each with its most m."""

    q: Floats
    error_m: float
    joints: dict[int, float]


def version_doubts(held: HoldoutEvaluator, verdict: str, unseen: UnseenFit | None) -> tuple[Doubt, ...]:
    """Return what a version doubts of itself: near each visit that was set aside, and everywhere if the run is unexplained."""
    source = held.search.problem.settings.source
    found = _doubts_near_set_aside(source, list(_aside(held))) if source.observes_tool and not held.moving else []
    if verdict == "unexplained":
        n, error = source.model.robot.n_joints, 0.0 if unseen is None or not unseen.refutes_model else unseen.beyond
        found.append(Doubt.everywhere(n, error, NOT_CLOSED))
    return tuple(found)


def _aside(held: HoldoutEvaluator) -> Iterator[Aside]:
    """Visits of the rows searched, then rows held out, that were set aside."""
    search = held.search
    settings, values = search.problem.settings, search.problem.values
    shared = settings.source.joint_columns(values)
    longest = [
        max(settings.source.rms(one[None]) for one in shared(j)) for j in range(settings.source.model.robot.n_joints)
    ]
    yield from _errors(settings.source, values, ~settings.used, settings.of_visit, longest)
    if held.rows is not None and not held.valid_row_mask.all():
        other, there = on_rows(settings.source, held.rows, search, values)
        yield from _errors(
            other,
            there,
            ~held.valid_row_mask,
            np.broadcast_to(settings.of_row, (len(held.rows), *settings.of_row.shape)),
            longest,
        )


def _errors(source: Source, values: Floats, which: Bools, noise: Floats, longest: list[float]) -> Iterator[Aside]:
    """Visits ``which (V,)`` of a source under their noise (V, m, m); ``longest (n,)`` m per rad of each joint's motion."""
    left, columns, rows = np.nan_to_num(source.residual(values)), source.joint_columns(values), np.flatnonzero(which)
    motions = [columns(j) for j in range(len(longest))]
    for row in rows:
        back, error = np.linalg.inv(cholesky_root(noise[row])), source.rms(left[[row]])
        joints = {}
        for j, motion in enumerate(motions):
            lever, size = source.rms(motion[[row]]), len(back)
            e, w = back @ left[row], back @ motion[row]
            beside = e - w * (w @ e) / max(float(w @ w), 1e-300)
            if size > 1 and lever > LEVER * longest[j] and beside @ beside < chi2.isf(BY_NOISE, size - 1):
                joints[j] = error * longest[j] / lever
        yield Aside(source.observations.q[row], error, joints)


def _doubts_near_set_aside(source: Source, aside: list[Aside]) -> list[Doubt]:
    """Boxes: along each joint that may have made an error, at any angle of the others; else about the pose in all joints."""
    robot = source.model.robot
    half = np.array([NEAR_M if joint.kind == "prismatic" else NEAR_RAD for joint in robot.joints])
    out = [Doubt(one.q - half, one.q + half, one.error_m, NEAR) for one in aside if not one.joints]
    for j in range(robot.n_joints):
        own = sorted((float(one.q[j]), one.joints[j]) for one in aside if j in one.joints)
        while own:
            low, error = own.pop(0)
            high = low
            while own and own[0][0] - high <= 2.0 * half[j]:
                high, error = own[0][0], max(error, own.pop(0)[1])
            box = Doubt.everywhere(robot.n_joints, error, NEAR)
            box.low[j], box.high[j] = low - half[j], high + half[j]
            out.append(box)
    return out
