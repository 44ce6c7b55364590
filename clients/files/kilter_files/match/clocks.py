"""Two clocks: where the joint log's time zero lies in the recording's, and how fast they drift apart.

Coarse by a path of lags, by the robot's model or the two speeds. Then refined without knowing the arm: what markers on a
hand do is a sum of products of sines and cosines of the joints, so offset and drift are those at which such a sum fits
the markers best (Gauss-Newton, the sum's factors projected out). The scatter of the slopes of one-second blocks gives
the uncertainty; it counts errors that stay for a while, as errors of a fit do.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.match.clock_checks import Checks, follow_clocks, refuse_drift
from kilter_files.match.dwells import Thinned
from kilter_files.tables.table import JointLog

SEARCH_S = 0.3
STEPS = 20
MOST_TERMS = 800
MOST_FRAMES = 6000
FRAMES_PER_TERM = 5
BLOCK_S = 1.0


@dataclass(frozen=True)
class Clocks:
    """Log time = recording time + ``offset_s`` + ``drift`` (recording time - ``middle_s``), with standard deviations."""

    offset_s: float
    drift: float
    middle_s: float
    offset_sigma_s: float
    drift_sigma: float
    correlation: float
    frames: int

    def log_time(self, t_s: Floats) -> Floats:
        """Return the log's time of the recording's times."""
        return np.asarray(t_s + self.offset_s + self.drift * (t_s - self.middle_s))

    def sigma_s(self, t_s: float) -> float:
        """Return the standard deviation of the log's time at a time of the recording."""
        return float(np.hypot(self.offset_sigma_s, self.drift_sigma * (t_s - self.middle_s)))


@dataclass(frozen=True)
class Pieces:
    """Clocks of parts (start, end, clocks) of a recording that jump in between, and times (start, end) that have none."""

    parts: tuple[tuple[float, float, Clocks], ...]
    lost: tuple[tuple[float, float], ...] = ()

    def log_time(self, t_s: Floats) -> Floats:
        """Return the log's time of the recording's times, NaN between the parts."""
        out = np.full(np.shape(t_s), np.nan)
        for start, end, clocks in self.parts:
            inside = (t_s >= start) & (t_s <= end)
            out[inside] = clocks.log_time(t_s[inside])
        for start, end in self.lost:
            out[(t_s >= start) & (t_s <= end)] = np.nan
        return out

    def together(self, start_s: float, end_s: float) -> bool:
        """Whether two times lie in one part, and nothing lost between them."""
        whole = any(start <= start_s and end_s <= end for start, end, _ in self.parts)
        return whole and not any(start <= end_s and start_s <= end for start, end in self.lost)


def match_pieces(path: Path, thinned: Thinned, log: JointLog, checks: Checks) -> tuple[Pieces, list[str]]:
    """Match the clocks part by part between their jumps, where ``checks`` allow it; return warnings too.

    Raises:
        FileError: no time in the log, motions that do not resemble each other, too few of them, or a model that explains
            no part.

    """
    if log.t_s is None or len(log) < 20:
        raise fault(log.path, "has no t_s, or fewer than 20 rows", "Match by rows in order (--by order).")
    found = follow_clocks(path, thinned, log, checks)
    parts, warnings = [], list(found.warnings)
    for start, end, lag in found.parts:
        own = (thinned.t_s >= start) & (thinned.t_s <= end)
        t, p = _in_sight(Thinned(thinned.t_s[own], thinned.points_mm[own], thinned.step_s), log, lag)
        if len(t) < 60 or float(np.ptp(p, axis=0).max()) < 5.0:
            what = f"only {len(t)} frames with motion and markers in sight lie within {log.path.name}"
            if len(found.parts) == 1:
                raise fault(path, what, "Record more motion, or match dwells in order (--by order).")
            warnings.append(f"from {start:.2f} to {end:.2f} s {what}: that part is left out")
            continue
        near = lag if found.sure else _search_lag(t, p, log, lag)
        clocks = _refine_clocks(t, p, log, near, found.correlation)
        parts.append((start, end, clocks))
        warnings += refuse_drift(path, log, clocks.drift, clocks.drift_sigma, checks)
    if not parts:
        raise fault(path, "no part between the jumps holds enough motion", "Record again, with clocks that stay.")
    if len(parts) == 1 and len(found.parts) == 1:
        parts = [(-np.inf, np.inf, parts[0][2])]
    return Pieces(tuple(parts), found.lost), warnings


def _in_sight(thinned: Thinned, log: JointLog, coarse: float) -> tuple[Floats, Floats]:
    """Return times and coordinates (n, 3 per marker) of the frames in which the best-seen markers are all seen."""
    assert log.t_s is not None
    t, points = thinned.t_s, thinned.points_mm
    inside = (t + coarse - SEARCH_S > log.t_s[0]) & (t + coarse + SEARCH_S < log.t_s[-1])
    seen = ~np.isnan(points[..., 0])
    best = np.argsort(-seen[inside].sum(axis=0), kind="stable")[:3]
    together = inside & seen[:, best].all(axis=1)
    if together.sum() < inside.sum() / 2:
        best = best[:1]
        together = inside & seen[:, best].all(axis=1)
    every = max(1, -(-int(together.sum()) // MOST_FRAMES))
    index = np.flatnonzero(together)[::every]
    p = points[index][:, best].reshape(len(index), -1)
    return t[index], p - p.mean(axis=0) if len(index) else p


def _refine_clocks(t: Floats, p: Floats, log: JointLog, coarse: float, correlation: float) -> Clocks:
    offset, drift, middle = coarse, 0.0, float(t.mean())
    terms = _Terms(log, len(t) // FRAMES_PER_TERM)
    for _ in range(STEPS):
        left, sides = _slopes(terms, t - middle, t + offset + drift * (t - middle), p)
        square = np.einsum("ank,bnk->ab", sides, sides)
        step = np.linalg.solve(square, np.einsum("ank,nk->a", sides, left))
        offset, drift = offset + float(np.clip(step[0], -0.1, 0.1)), drift + float(np.clip(step[1], -2e-3, 2e-3))
        if abs(step[0]) < 1e-8 and abs(step[1]) < 1e-9:
            break
    each = np.einsum("ank,nk->na", sides, left)
    blocks = np.unique(np.floor((t - t[0]) / BLOCK_S), return_inverse=True)[1]
    sums = np.stack([np.bincount(blocks, each[:, i]) for i in (0, 1)], axis=1)
    back = np.linalg.inv(square)
    covariance = back @ (sums.T @ sums) @ back * len(t) / max(1, len(t) - terms.count)
    sigma, sigma_drift = np.sqrt(np.diag(covariance))
    return Clocks(offset, drift, middle, float(sigma), float(sigma_drift), correlation, len(t))


def _search_lag(t: Floats, p: Floats, log: JointLog, coarse: float) -> float:
    """Return the lag near the coarse one at which products of two joints fit best."""
    every = max(1, len(t) // 1500)
    t, p, terms = t[::every], p[::every], _Terms(log, len(t[::every]) // FRAMES_PER_TERM)
    tries = coarse + np.linspace(-SEARCH_S, SEARCH_S, 25)
    return float(
        min(tries, key=lambda lag: float((_projection_residual(terms.terms_and_rates(t + lag)[0], p) ** 2).sum()))
    )


def _projection_residual(terms: Floats, p: Floats) -> Floats:
    """What a sum of the terms leaves of ``p``."""
    basis = _basis(terms)
    return np.asarray(p - basis @ (basis.T @ p))


def _basis(terms: Floats) -> Floats:
    """Return an orthonormal basis of the terms; those that say the same count once."""
    values, vectors = np.linalg.eigh(terms.T @ terms)
    good = values > values[-1] * 1e-10
    return np.asarray(terms @ (vectors[:, good] / np.sqrt(values[good])))


def _slopes(terms: _Terms, away: Floats, log_t: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Return what is left of ``p``, and how that changes with offset and drift (2, n, coordinates)."""
    now, rate = terms.terms_and_rates(log_t)
    values, vectors = np.linalg.eigh(now.T @ now)
    good = values > values[-1] * 1e-10
    turn = vectors[:, good] / np.sqrt(values[good])
    basis = now @ turn
    shares = basis.T @ p
    slope = rate @ (turn @ shares)
    sides = [slope, slope * away[:, None]]
    return p - basis @ shares, np.stack([side - basis @ (basis.T @ side) for side in sides])


class _Terms:
    """Products of sines and cosines of the joints that move, of the highest degree that ``most`` terms allow."""

    def __init__(self, log: JointLog, most: int) -> None:
        assert log.t_s is not None
        self._t, q = log.t_s, log.q_even()
        self._moving = [i for i in range(q.shape[1]) if np.ptp(q[:, i]) > 0.5]
        self._q = q
        self._turns = [log.joints[i].endswith(("deg", "rad")) for i in range(q.shape[1])]
        sizes = [2 if self._turns[i] else 1 for i in self._moving]
        self._sets: list[tuple[int, ...]] = [()]
        self.count = 1
        for degree in range(1, len(self._moving) + 1):
            sets = list(itertools.combinations(range(len(self._moving)), degree))
            more = sum(math.prod(sizes[i] for i in chosen) for chosen in sets)
            if self.count + more > max(min(most, MOST_TERMS), 1 + sum(sizes)):
                break
            self._sets += sets
            self.count += more

    def terms_and_rates(self, log_t: Floats) -> tuple[Floats, Floats]:
        """Return the terms (n, terms) at times of the log, and their rates."""
        parts = [self._joint(i, log_t) for i in self._moving]
        known: dict[tuple[int, ...], tuple[Floats, Floats]] = {}
        ones = np.ones((len(log_t), 1))
        known[()] = (ones, np.zeros_like(ones))
        for chosen in self._sets[1:]:
            value, rate = known[chosen[:-1]]
            own, own_rate = parts[chosen[-1]]
            both = [
                (value[:, :, None] * own[:, None]),
                rate[:, :, None] * own[:, None] + value[:, :, None] * own_rate[:, None],
            ]
            known[chosen] = (both[0].reshape(len(log_t), -1), both[1].reshape(len(log_t), -1))
        return np.hstack([known[c][0] for c in self._sets]), np.hstack([known[c][1] for c in self._sets])

    def _joint(self, i: int, log_t: Floats) -> tuple[Floats, Floats]:
        q = np.interp(log_t, self._t, self._q[:, i])
        rate = np.interp(log_t, self._t, np.gradient(self._q[:, i], self._t))
        if not self._turns[i]:
            size = max(float(np.ptp(self._q[:, i])), 1e-9)
            return (q / size)[:, None], (rate / size)[:, None]
        q, rate = np.radians(q), np.radians(rate)
        return np.stack([np.cos(q), np.sin(q)], 1), np.stack([-np.sin(q) * rate, np.cos(q) * rate], 1)
