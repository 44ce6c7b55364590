"""Whether the robot's model explains which joints go with which markers: rows that it cannot, and where the body moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.match.arm import Arm
from kilter_files.match.lag_evidence import spread
from kilter_files.match.registration import Registration, error_columns, fit_arm_errors, register

EXPLAINED = 0.06  # of the markers' spread that a model may leave where it explains them
WINDOW = (6, 16)
LEAST_ROWS = 8
ROUNDS = 6
FAR = 8.0  # times what the model usually leaves: another pose, not an error of the arm
LEAST_MM = 1.0
CALIBRATED_ROWS = 25


@dataclass(frozen=True)
class Pairing:
    """What the model leaves in each row, mm (n), what counts as unexplained, and the registration; None: explains nothing."""

    off_mm: Floats
    limit_mm: float
    found: Registration | None
    share: float

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Rows that the model does not explain."""
        return np.asarray(self.off_mm > self.limit_mm)


def check_pairs(arm: Arm, q: Floats, points: Floats) -> Pairing | None:
    """Check joints (n, joints; rad, mm) against markers (n, m, 3); None when there are too few rows to tell.

    The stretch of consecutive rows that one registration explains best is taken to be right, and grown.
    """
    seen = ~np.isnan(points[..., 0]).all(axis=1)
    if seen.sum() < LEAST_ROWS:
        return None
    rows = np.flatnonzero(seen)
    turns, places = arm.poses(q)
    found, share = _best_window(turns, places, points, rows)
    off = _off(points, found.predict_markers(turns, places))
    if share > EXPLAINED:
        return Pairing(off, np.inf, None, share)
    limit = max(EXPLAINED * spread(points), LEAST_MM)
    for _ in range(ROUNDS):
        good = np.flatnonzero(off < limit)
        if len(good) < WINDOW[0]:
            break
        found = register(turns[good], places[good], points[good])
        off = _off(points, found.predict_markers(turns, places))
        limit = max(FAR * float(np.sqrt(np.mean(off[good] ** 2))), LEAST_MM)
    return _sharper(arm, q, points, Pairing(off, limit, found, share))


def _sharper(arm: Arm, q: Floats, points: Floats, first: Pairing) -> Pairing:
    """Fit small errors of the arm too, where the rows allow it, so that a small wrong rotation shows."""
    good = np.flatnonzero(~first.wrong & ~np.isnan(first.off_mm))
    if len(good) < CALIBRATED_ROWS or first.found is None:
        return first
    found, _ = fit_arm_errors(arm, q[good], points[good], first.found)
    off = off_calibrated(arm, q, points, found)
    limit = max(FAR * float(np.sqrt(np.mean(off[good] ** 2))), LEAST_MM)
    return Pairing(off, limit, found, first.share)


def off_calibrated(arm: Arm, q: Floats, points: Floats, found: Registration) -> Floats:
    """Return what a calibrated registration leaves in each row, mm (n)."""
    turns, places = arm.poses(q)
    return _off(points, found.predict_markers(turns, places, error_columns(arm, q, found.in_base(turns, places))))


def _best_window(turns: Floats, places: Floats, points: Floats, rows: NDArray[np.int64]) -> tuple[Registration, float]:
    width = int(np.clip(len(rows) // 4, *WINDOW))
    if points.shape[1] == 1:
        width = min(len(rows), max(width, WINDOW[0] + 2))
    starts = range(0, len(rows) - width + 1, max(1, width // 3))
    tried = [_register_rows(turns, places, points, rows[k : k + width]) for k in starts]
    return min(tried, key=lambda pair: pair[1])


def _register_rows(
    turns: Floats, places: Floats, points: Floats, rows: NDArray[np.int64]
) -> tuple[Registration, float]:
    found = register(turns[rows], places[rows], points[rows])
    off = _off(points[rows], found.predict_markers(turns[rows], places[rows]))
    least = max(spread(points[rows]), 0.3 * spread(points), 1e-9)
    return found, float(np.sqrt(np.mean(off**2))) / least


def _off(points: Floats, predicted: Floats) -> Floats:
    square = np.sum((points - predicted) ** 2, axis=-1)
    seen = ~np.isnan(square)
    count = np.where(seen.any(axis=-1), seen.sum(axis=-1), np.nan)
    return np.asarray(np.sqrt(np.where(seen, square, 0.0).sum(axis=-1) / count))


def fitting_rows(arm: Arm, q: Floats, points: Floats, pairing: Pairing) -> NDArray[np.int64]:
    """Return for each row of markers the joints (row of ``q``) that fit it best, -1 where none fits."""
    assert pairing.found is not None
    turns, places = arm.poses(q)
    plain = Registration(pairing.found.turn, pairing.found.place, pairing.found.markers, np.zeros(0))
    there = plain.predict_markers(turns, places)
    limit = max(2 * pairing.limit_mm, 0.02 * spread(points))
    out = np.full(len(points), -1, dtype=np.int64)
    for i, seen in enumerate(points):
        off = _off(np.broadcast_to(seen, there.shape), there)
        if not np.isnan(off).all() and np.nanmin(off) < limit:
            out[i] = int(np.nanargmin(off))
    return out
