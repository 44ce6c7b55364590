"""What a search set aside as wrong readings: its rows, its poses to be measured again, and what a version doubts near them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator, on_rows
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit
from kilter_core.gap.report.next_poses import set_aside_again
from kilter_core.gap.search.linear.in_space import cholesky_root
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.fit.tukey import points_mm, whitened_row_sizes
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts
from kilter_core.model import Calibration
from kilter_core.model.doubts import Doubt
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

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


def agreement_sentence(prepared: Prepared, held: Observations | None, spikes: Ints) -> str:
    """Say with how many visits a verdict goes, of those searched and held out; empty where none was set aside."""
    used = prepared.problem.settings.used
    visits = np.zeros(0, dtype=np.int64) if held is None else held.visits()
    seen = np.zeros(0, dtype=bool) if held is None else held.tool_seen
    aside = int(np.sum(~used)) + len(np.unique(visits[spikes]))
    total = len(used) + len(np.unique(visits[seen]))
    if not aside:
        return ""
    return (
        f" This is of {total - aside} of {total} visits: {aside} {'was' if aside == 1 else 'were'} set aside as wrong "
        "readings. Measure their poses again; what errs there again is the arm."
    )


def poses_again(prepared: Prepared, held: Observations | None, spikes: Ints) -> list[dict[str, Any]]:
    """The poses of what was set aside, of rows searched and held out, as documents: to be measured first."""
    source = prepared.problem.settings.source
    if not source.observes_places:
        return []
    parts = [prepared.given.select(prepared.outlying), *([] if held is None else [held.select(spikes)])]
    return [row for rows in parts if len(rows) for row in set_aside_again(rows, source.model.robot)]


def rows_aside(
    calibration: Calibration, rows: Observations | None, which: Ints, numbers: Ints, sigma: float
) -> tuple[dict[str, Any], ...]:
    """Rows ``which (K,)`` of some: ``row`` as ``numbers (N,)`` say, ``residual_mm`` and ``residual_sigma`` of its point.

    ``sigma`` is the standard deviation of a coordinate, m. Joint data and contacts have no point: both are None.
    """
    found: list[dict[str, Any]] = [
        {"row": int(row), "residual_mm": None, "residual_sigma": None, "weight": 0.0} for row in numbers[which]
    ]
    if rows is None or not found or (rows.position is None and rows.markers is None) or has_contacts(rows):
        return tuple(found)
    measurement = Measurement.from_observations(rows.select(which), calibration.marker_points)
    left = measurement.residual(calibration.predict(measurement.observations))
    size = whitened_row_sizes(left.of_points(), sigma, np.nan) if sigma > 0.0 else np.full(len(which), np.nan)
    for one, length, sigmas in zip(found, points_mm(left), size, strict=True):
        one["residual_mm"] = length
        one["residual_sigma"] = float(sigmas) if np.isfinite(sigmas) else None
    return tuple(found)
