"""A ball bar's log joined with the joint log: the joints at every reading, so that lengths calibrate without the command.

Both go along the same circle. Each run of the bar belongs to one pass of the log, in order; within it the angle says
which joints a reading was taken at.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_files.formats.logs.ballbar import BallBar
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.rig.drawn_circle import commanded_mm, refuse_other_length
from kilter_files.tables.table import JointLog, Table

NEAR_MM = 1.5  # rows of the log farther from the circle are the way to it
SAME_FOOT_MM = 0.5
SHORTEST_PASS_DEG = 20.0
TOLERANCE_DEG = 1.0
UPRIGHT = 0.1


@dataclass(frozen=True)
class Pass:
    """One pass: rows of the log, their angle in degrees, which only rises or only falls, and the centre mount's place."""

    rows: NDArray[np.int64]
    angle_deg: Floats
    centre_mm: Floats
    radius_mm: float

    @property
    def direction(self) -> str:
        """Counterclockwise or clockwise, seen from above."""
        return "ccw" if self.angle_deg[-1] > self.angle_deg[0] else "cw"


def join_ballbar(bar: BallBar, log: JointLog, zero_deg: float = 0.0) -> tuple[Table, dict[str, Any]]:
    """Join: one row per reading; ``zero_deg`` is where the bar's angle 0 lies, counted from the robot's x axis.

    Raises:
        FileError: a log that goes along no circle, or not along the bar's, or along a circle of another radius.

    """
    passes = find_circle_passes(log)
    runs = [np.flatnonzero(bar.run == run) for run in np.unique(bar.run)]
    ways = ["ccw" if np.median(np.diff(bar.angle_deg[run])) > 0 else "cw" for run in runs]
    if ways != [way.direction for way in passes]:
        what = f"has {len(runs)} runs ({', '.join(ways)}), {log.path.name} goes round {len(passes)} times"
        said = ", ".join(way.direction for way in passes)
        raise fault(bar.path, f"{what} ({said or 'never'})", "Give the log of the same runs, in the same order.")
    for way in passes:
        refuse_other_length(bar.path, bar.nominal_mm, way.radius_mm)
    columns: dict[str, list[float]] = {name: [] for name in (*log.joints, "bar_id", "bar_mm")}
    feet: list[Floats] = []
    lines: list[int] = []
    for run, way in zip(runs, passes, strict=True):
        angle = _unwrap_to_pass(bar, bar.angle_deg[run] + zero_deg, way, zero_deg)
        order = np.argsort(way.angle_deg)
        for name in log.joints:
            values = log.columns[name][way.rows]
            columns[name] += [float(v) for v in np.interp(angle, way.angle_deg[order], values[order])]
        columns["bar_id"] += [float(_foot(feet, way.centre_mm))] * len(run)
        columns["bar_mm"] += [round(float(v), 6) for v in bar.radius_mm[run]]
        lines += [int(line) for line in bar.line[run]]
    table = Table(columns, lines, list(bar.notes), list(bar.warnings))
    table.notes.append(f"{len(runs)} runs about {len(feet)} centre mounts have their joints from {log.path.name}")
    return table, {"rows": len(lines), "runs": len(runs), "feet": len(feet), "radius_mm": round(passes[0].radius_mm, 4)}


def find_circle_passes(log: JointLog) -> list[Pass]:
    """Find every way round a circle that is seen from above; feed-in along the circle belongs to it.

    Raises:
        FileError: no commanded positions, or no circle among them.

    """
    p = commanded_mm(log)
    out = []
    for part in _on_circles(p):
        centre, axes, radius = _circle(p[part])
        local = (p[part] - centre) @ axes
        angle = np.degrees(np.unwrap(np.arctan2(local[:, 1], local[:, 0])))
        out += [Pass(part[piece], angle[piece], centre, radius) for piece in _monotone(angle)]
    if not out:
        raise fault(log.path, "goes along no circle", "Give the log of the ball bar's runs, with x_mm, y_mm, z_mm.")
    return out


def _on_circles(p: Floats) -> list[NDArray[np.int64]]:
    """Stretches of rows that lie on one circle each: neighbours whose curvature and plane agree."""
    out: list[NDArray[np.int64]] = []
    left = np.arange(len(p))
    while len(left) >= 8:
        best = max(
            (_grown(p, left, k) for k in range(0, len(left), max(1, len(left) // 12))), key=len, default=left[:0]
        )
        if len(best) < 8:
            break
        out.append(best)
        left = np.setdiff1d(left, np.arange(best[0], best[-1] + 1))
    return sorted(out, key=lambda rows: int(rows[0]))


def _grown(p: Floats, left: NDArray[np.int64], at: int) -> NDArray[np.int64]:
    """Rows of ``left`` around ``at``, without a gap, near the circle through the ones next to it."""
    near = left[max(0, at - len(left) // 24 - 4) : at + len(left) // 24 + 4]
    if len(near) < 6:
        return left[:0]
    found = near
    for _ in range(3):
        centre, axes, radius = _circle(p[found])
        local = (p - centre) @ axes
        on = (np.abs(np.hypot(local[:, 0], local[:, 1]) - radius) < NEAR_MM) & (np.abs(local[:, 2]) < NEAR_MM)
        on &= np.isin(np.arange(len(p)), left) & (radius < 1e4)
        if not on[near].all():
            return left[:0]
        first, last = int(near[0]), int(near[-1])
        while first > 0 and on[first - 1]:
            first -= 1
        while last < len(p) - 1 and on[last + 1]:
            last += 1
        found = np.arange(first, last + 1)
    return found


def _circle(p: Floats) -> tuple[Floats, Floats, float]:
    """Centre, axes (x along the robot's, z up) and radius of the circle that fits the points best."""
    middle = p.mean(axis=0)
    normal = np.linalg.svd(p - middle, full_matrices=False)[2][2]
    # Up; of a circle that stands upright, along the robot's y or x.
    main = next((k for k in (2, 1, 0) if abs(normal[k]) > UPRIGHT), 2)
    normal = normal if normal[main] > 0 else -normal
    x = np.eye(3)[0] if abs(normal[0]) < 0.9 else np.eye(3)[1]
    x = x - normal * (x @ normal)
    axes = np.stack([x / np.linalg.norm(x), np.cross(normal, x / np.linalg.norm(x)), normal], axis=1)
    flat = ((p - middle) @ axes)[:, :2]
    a, b, c = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(p))]), (flat**2).sum(axis=1), rcond=None)[0]
    return middle + axes[:, :2] @ [a, b], axes, float(np.sqrt(max(c + a * a + b * b, 0.0)))


def _monotone(angle: Floats) -> list[NDArray[np.int64]]:
    """Stretches in which the angle only rises or only falls, rests left out."""
    step = np.diff(angle)
    moving = np.flatnonzero(np.abs(step) > 1e-6)
    out = []
    for piece in np.split(moving, np.flatnonzero(np.diff(np.sign(step[moving])) != 0) + 1):
        if len(piece):
            rows = np.append(piece, piece[-1] + 1)
            if abs(angle[rows[-1]] - angle[rows[0]]) > SHORTEST_PASS_DEG:
                out.append(rows)
    return out


def _unwrap_to_pass(bar: BallBar, angle: Floats, way: Pass, zero_deg: float) -> Floats:
    """Angles of a run, whole turns added so that the log's pass covers them."""
    angle = np.degrees(np.unwrap(np.radians(angle)))
    low, high = way.angle_deg.min() - TOLERANCE_DEG, way.angle_deg.max() + TOLERANCE_DEG
    turns = [k for k in range(-4, 5) if angle.min() + 360 * k >= low and angle.max() + 360 * k <= high]
    if len(turns) != 1:
        there = f"from {way.angle_deg[0] % 360:.1f} deg over {np.ptp(way.angle_deg):.1f} deg"
        what = f"a run begins at {angle[0] % 360:.1f} deg and covers {np.ptp(angle):.1f} deg, the log goes {there}"
        other = (zero_deg + way.angle_deg[0] - angle[0]) % 360
        remedy = f"If the bar's angle 0 is not the robot's x axis, give where it is (here --zero-deg {other:.1f})"
        raise fault(bar.path, what, remedy + "; or give the log of these runs alone.")
    return np.asarray(angle + 360 * turns[0])


def _foot(feet: list[Floats], centre: Floats) -> int:
    for k, known in enumerate(feet, 1):
        if np.linalg.norm(known - centre) < SAME_FOOT_MM:
            return k
    feet.append(centre)
    return len(feet)
