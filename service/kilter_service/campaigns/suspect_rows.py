"""Rows that look wrong. They are marked and named, never left out: whoever measured knows what happened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import CoreError
from kilter_core.observations import Observations as Seen
from kilter_service.campaigns.repeats import MAD, Repeats
from kilter_service.ground.core import core_identify, core_model, transforms
from kilter_service.ground.wire import to_deg, to_mm

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.observations import Observations
    from kilter_core.types import Floats

MOST = 200  # rows that are named
MOVED = 1e-4  # rad or m: a joint has moved
BEYOND = 5e-3  # rad or m outside the limits: more than their rounding
FAR = 8.0  # robust standard deviations from where the arm would be
LEAST_M = 1e-3
MOST_PLACED = 50_000  # rows whose places are compared with the arm's
ROUNDS = 12
FEWEST_SUSPECT_ROWS = 12


@dataclass(frozen=True)
class Doubt:
    """A row, from 1, what looks wrong with it, and how far off it is: in mm, and in robust standard deviations."""

    row: int
    why: str
    mm: float | None = None
    sigma: float | None = None


@dataclass(frozen=True)
class Doubtful:
    """The first rows that look wrong, and how many there are."""

    rows: tuple[Doubt, ...]
    count: int


def doubtful(robot: Robot, seen: Observations, points: Floats | None, repeats: Repeats) -> Doubtful:
    """Name rows outside the limits, apart from their repeats, stuck at a reading, or far from where the arm would be."""
    found: dict[int, list[Doubt]] = {}

    def add_doubt(row: int, why: str, away: float | None = None, sigma: float | None = None) -> None:
        mm = None if away is None else float(to_mm(away))
        found.setdefault(row + 1, []).append(Doubt(row + 1, why, mm, sigma))

    _beyond(robot, seen, add_doubt)
    for row, distance, sigma in zip(repeats.far, repeats.distance, repeats.sigmas, strict=True):
        why = f"{to_mm(float(distance)):.3g} mm from the other rows of its pose"
        add_doubt(int(row), why, float(distance), float(sigma) if np.isfinite(sigma) else None)
    if points is not None:
        for row in _stuck(seen.q, points):
            add_doubt(int(row), "the same position as the row before to the last digit, though joints moved")
        for row, distance, sigma in _find_misplaced_rows(robot, seen, points):
            why = f"{to_mm(distance):.3g} mm from where the nominal arm would be, far more than other rows"
            add_doubt(row, why, distance, sigma)
    for row, distance in _of_other_pictures(robot, seen):
        why = "its picture shows the board far from where its joints would have it"
        add_doubt(row, why, distance if np.isfinite(distance) else None)
    named = sorted(found.items())[:MOST]
    return Doubtful(tuple(_together(doubts) for _, doubts in named), len(found))


def _together(doubts: Sequence[Doubt]) -> Doubt:
    """All that is said of a row; of the sizes those that stand out most."""
    lead = max(doubts, key=lambda one: (one.sigma or 0.0, one.mm or 0.0))
    return Doubt(lead.row, "; ".join(one.why for one in doubts), lead.mm, lead.sigma)


def _beyond(robot: Robot, seen: Observations, take: object) -> None:
    assert callable(take)
    for k, joint in enumerate(robot.joints):
        out = np.maximum(joint.lower - seen.q[:, k], seen.q[:, k] - joint.upper)
        for row in np.flatnonzero(out > BEYOND)[:MOST]:
            size = to_mm(out[row]) if joint.kind == "prismatic" else to_deg(out[row])
            unit = "mm" if joint.kind == "prismatic" else "deg"
            take(int(row), f"joint {joint.name} is {float(size):.3g} {unit} outside its limits")


def _stuck(q: Floats, points: Floats) -> NDArray[np.int64]:
    same = (np.diff(points, axis=0) == 0).all(axis=1)
    moved = np.abs(np.diff(q, axis=0)).max(axis=1) > MOVED
    return np.flatnonzero(same & moved).astype(np.int64) + 1


def _find_misplaced_rows(robot: Robot, seen: Observations, points: Floats) -> list[tuple[int, float, float]]:
    """Rows far from the nominal arm, base and tool point fitted to the others: m, and robust standard deviations."""
    there = np.flatnonzero(~np.isnan(points).any(axis=1))
    there = there[:: max(1, len(there) // MOST_PLACED)]
    if len(there) < FEWEST_SUSPECT_ROWS or (seen.session is not None and len(np.unique(seen.session)) > 1):
        return []
    left = _distances_from_nominal(robot, seen.q[there], points[there])
    middle = float(np.median(left))
    usual = max(MAD * float(np.median(np.abs(left - middle))), LEAST_M / FAR)
    far = np.flatnonzero(left - middle > FAR * usual)
    return [(int(there[row]), float(left[row]), float((left[row] - middle) / usual)) for row in far[:MOST]]


def _of_other_pictures(robot: Robot, seen: Observations) -> list[tuple[int, float]]:
    """Rows whose joints are not those of their picture, and how far off the board is there, m."""
    if seen.pixels is None:
        return []
    try:
        return core_identify.far_views(core_model.Calibration.nominal(robot), seen)[:MOST]
    except CoreError:
        return []  # what is wrong with all of them a job says


def _distances_from_nominal(robot: Robot, q: Floats, points: Floats) -> Floats:
    """How far (m) each point is from the nominal arm; base and tool point are fitted to the nearer half in turn."""
    model = core_model.Calibration.nominal(robot).model
    pose = model.in_frames(np.eye(4), np.eye(4)).predict(Seen(q), model.values0())
    f, F = pose.position, pose.rotation
    tool, kept = model.T_tool[:3, 3], np.ones(len(q), dtype=bool)
    left = np.zeros(len(q))
    for _ in range(ROUNDS):
        body = f + F @ tool
        a, b = body[kept].mean(axis=0), points[kept].mean(axis=0)
        R = transforms.nearest_rotation((body[kept] - a).T @ (points[kept] - b))
        local = (points - b) @ R.T + a
        tool = np.median(np.einsum("nji,nj->ni", F, local - f)[kept], axis=0)
        left = np.linalg.norm(f + F @ tool - local, axis=1)
        kept = left <= np.quantile(left, 0.75)
    return np.asarray(left)
