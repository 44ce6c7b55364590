"""Joints and positions that do not belong together: no base and no tool makes more of them than of shuffled rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.identify.plausibility.believable import reach
from kilter_core.identify.plausibility.lacking import find_lacking
from kilter_core.identify.plausibility.placed import Sample, place
from kilter_core.observations import Observations
from kilter_core.types import Floats

SHUFFLES = 5
FAR = 0.03  # share of the workspace below which errors of an arm may leave it
SHARE = 0.5  # of what shuffled rows leave: rows that belong together leave less
OF_REACH = 0.1  # more than this is left by no arm that is the one described
MOVED_M = 0.02  # rms distance of points and flange from their middle, below which nothing is told
STEPS = 8
DIFFERENCE_RAD = 1e-5
FARTHEST_RAD, FARTHEST_M = np.radians(30.0), 0.1  # by which a zero is off that was mastered, badly
EXPLAINED = 0.2  # share of the residual that joint zeros may leave and still explain it


@dataclass(frozen=True)
class Misfit:
    """What base and tool leave (m) of the rows, and of the same rows shuffled; what the description lacks, in words."""

    left: float
    shuffled: float
    lacking: str = ""

    @property
    def belongs(self) -> bool:
        """Whether joints and positions belong together: shuffled rows leave far more, or one transform explains them."""
        return bool(self.lacking) or self.left <= SHARE * self.shuffled


def find_misfit(sample: Sample) -> Misfit | None:
    """What rows leave that are not of the arm described; None where zeros of the joints or errors of an arm explain it."""
    left = sample.fitted_placement.size
    if (
        sample.spread < MOVED_M
        or left < FAR * sample.spread
        or with_zeros(sample).fitted_placement.size < EXPLAINED * left
    ):
        return None
    shuffled, lacking = _residual_of_shuffled_rows(sample), find_lacking(sample)
    if lacking.left <= EXPLAINED * left:
        return Misfit(left, shuffled, lacking.words)
    fits = left <= SHARE * shuffled and left <= OF_REACH * reach(sample.begin.robot)
    return None if fits else Misfit(left, shuffled)


def _residual_of_shuffled_rows(sample: Sample) -> float:
    rng = np.random.default_rng(0)
    shuffled = [sample.flange[rng.permutation(len(sample))] for _ in range(SHUFFLES)]
    return float(np.median([place(flange, sample.points).size for flange in shuffled]))


def mastered_otherwise(sample: Sample, left: float) -> bool:
    """Whether other zeros of the joints leave no more than ``left`` m: then the arm was mastered wrong, and nothing mixed up.

    A reading in which a joint hardly moves lets the tool take up the zero of the joint before it, so a wrong zero may look
    like another unit.
    """
    found = with_zeros(sample)
    moved = np.abs(found.q[0] - sample.q[0])
    turns = np.array([joint.kind == "revolute" for joint in sample.begin.robot.joints])
    return found.fitted_placement.size <= left and bool(np.all(moved <= np.where(turns, FARTHEST_RAD, FARTHEST_M)))


def with_zeros(sample: Sample) -> Sample:
    """The sample with the zeros of the joints fitted too, from where they are."""
    now = sample
    for _ in range(STEPS):
        changed = _step_joint_zeros(now)
        if changed.fitted_placement.size >= 0.999 * now.fitted_placement.size:
            break
        now = changed
    return now


def _step_joint_zeros(sample: Sample) -> Sample:
    """The sample after one damped step in the zeros of its joints, base and tool following."""
    n, placed = sample.q.shape[1], sample.fitted_placement
    here = placed.predict_points(sample.flange)
    columns = [
        (_points_after_joint_step(sample, _joint_step(n, k)) - here).reshape(-1) / DIFFERENCE_RAD for k in range(n)
    ]
    frames = [_frame(sample, k) for k in range(9)]
    J = np.column_stack([*columns, *frames])
    r = (sample.points - here).reshape(-1)
    H = J.T @ J
    x = np.linalg.solve(H + 1e-6 * np.trace(H) / len(H) * np.eye(len(H)), J.T @ r)
    tried = [replace(sample, q=sample.q + share * x[:n]) for share in (1.0, 0.5, 0.25)]
    return min(tried, key=lambda s: s.fitted_placement.size)


def _joint_step(n: int, k: int) -> Floats:
    return np.asarray(DIFFERENCE_RAD * np.eye(n)[k])


def _points_after_joint_step(sample: Sample, by: Floats) -> Floats:
    """Points (K, 3) of the placed sample with its joints moved."""
    seen = sample.begin.predict(Observations(q=sample.q + by))
    flange = np.tile(np.eye(4), (len(sample), 1, 1))
    flange[:, :3, :3], flange[:, :3, 3] = seen.rotation, seen.position
    return sample.fitted_placement.predict_points(flange)


def _frame(sample: Sample, k: int) -> Floats:
    """Derivative (3 K,) of the placed points by a number of the base (rotation, place) or of the tool point."""
    placed, axis = sample.fitted_placement, np.eye(3)[k % 3]
    if k < 3:
        return np.asarray(np.cross(axis, placed.predict_points(sample.flange) - placed.place).reshape(-1))
    if k < 6:
        return np.tile(axis, len(sample))
    return np.asarray((placed.rotation @ sample.flange[:, :3, :3] @ axis).reshape(-1))
