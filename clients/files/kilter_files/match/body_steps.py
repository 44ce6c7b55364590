"""A whole body of markers knocked on its mount: distances stay, but the residual of the robot's model steps at that moment.

Each row is transformed into the tool's frame and reduced to six numbers, shift and rotation of the body from where
it should. What base, markers and small errors of the arm explain of them is taken off; then a step is sought in time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.match.arm import Arm
from kilter_files.match.registration import NOISE_MM, Registration, fit_arm_errors, marker_jacobian

LEAST_ROWS = 16
LEAST_MM = 0.25
SURE_F = 8.0
LEAST_FREE = 30
SEEN_SHARE = 0.8


class Step(NamedTuple):
    """Between two times the body came to sit ``size_mm`` elsewhere on the tool."""

    from_s: float
    to_s: float
    size_mm: float

    def describe_step(self) -> str:
        """Say it in words."""
        when = f"between {self.from_s:.2f} and {self.to_s:.2f} s"
        return f"the markers as a whole moved {self.size_mm:.2f} mm on the tool {when}, by the robot's model"


def find_step(arm: Arm, q: Floats, points: Floats, spans: Floats, start: Registration) -> Step | None:
    """Find the clearest step of the body on the tool; None when there is none, or too few rows to see one."""
    points, start = _together(points, start)
    rows = np.flatnonzero(~np.isnan(points).any(axis=(1, 2)))
    if len(rows) < LEAST_ROWS:
        return None
    q, points, spans = q[rows], points[rows], spans[rows]
    left, columns, motions = _in_tool(arm, q, points, start)
    n, k = left.shape
    sizes = np.maximum(1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0), 1e-6)
    y = (left / sizes).ravel()
    basis = _basis((columns / sizes[:, None]).reshape(n * k, -1), NOISE_MM / float(np.median(sizes)))
    free = n * k - basis.shape[1] - k
    if free < LEAST_FREE:
        return None
    y = y - basis @ (basis.T @ y)
    best, at, shift = 0.0, 0, np.zeros(k)
    for cut in range(1, n):
        gain, own = _gain(y, basis, n, k, cut)
        if gain > best:
            best, at, shift = gain, cut, own
    rest = max(float(y @ y) - best, 1e-12)
    size = float(np.sqrt(np.mean(np.sum((motions @ (shift * sizes)).reshape(-1, 3) ** 2, axis=1))))
    if best / k / (rest / free) < SURE_F or size < LEAST_MM:
        return None
    return Step(float(spans[at - 1, 0]), float(spans[at, 1]), size)


def _together(points: Floats, start: Registration) -> tuple[Floats, Registration]:
    """The best-seen markers, as many as most rows show together."""
    seen = ~np.isnan(points[..., 0])
    order = np.argsort(-seen.sum(axis=0), kind="stable")
    counts = [int(seen[:, order[: k + 1]].all(axis=1).sum()) for k in range(len(order))]
    most = max(k for k, count in enumerate(counts) if count >= SEEN_SHARE * counts[0])
    chosen = np.sort(order[: most + 1])
    return points[:, chosen], replace(start, markers=start.markers[chosen])


def _in_tool(arm: Arm, q: Floats, points: Floats, start: Registration) -> tuple[Floats, Floats, Floats]:
    """What is left (n, k) in rigid motions of the body, its columns (n, k, unknowns), and the motions (3m, k)."""
    turns, places = arm.poses(q)
    plain = Registration(start.turn, start.place, start.markers, np.zeros(0))
    found, errors = fit_arm_errors(arm, q, points, plain)
    left = points - found.predict_markers(turns, places, errors)
    columns = marker_jacobian(found, turns, places, errors)
    back = np.swapaxes(found.turn @ turns, 1, 2)
    motions = _rigid(found.markers)
    n = len(q)
    own = np.einsum("nij,nmj->nmi", back, left).reshape(n, -1) @ motions
    turned = np.einsum("nij,nmjp->nmip", back, columns).reshape(n, motions.shape[0], -1)
    return own, np.einsum("ak,nap->nkp", motions, turned), motions


def _rigid(markers: Floats) -> Floats:
    """An orthonormal basis of small rigid motions of the markers: (3 m, 6), fewer where they do not show a rotation."""
    away = markers - markers.mean(axis=0)
    columns = [np.tile(axis, (len(markers), 1)).ravel() for axis in np.eye(3)]
    columns += [np.cross(axis, away).ravel() / 100.0 for axis in np.eye(3)]
    u, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return np.asarray(u[:, s > 1e-3 * s[0]])


def _basis(columns: Floats, held: float) -> Floats:
    """An orthonormal basis of what the unknowns explain; directions that matter less than what holds them do not count."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > max(held, 1e-6 * s[0])])


def _gain(y: Floats, basis: Floats, n: int, k: int, cut: int) -> tuple[float, Floats]:
    """How much of ``y`` a step at ``cut`` explains, and the step."""
    step = np.zeros((n, k, k))
    step[cut:] = np.eye(k)
    columns = step.reshape(n * k, k)
    columns = columns - basis @ (basis.T @ columns)
    square = columns.T @ columns
    values, vectors = np.linalg.eigh(square)
    good = values > 0.05 * min(cut, n - cut)
    if not good.any():
        return 0.0, np.zeros(k)
    side = vectors[:, good].T @ (columns.T @ y)
    return float(np.sum(side**2 / values[good])), vectors[:, good] @ (side / values[good])
