"""Speeds of the markers and of the joints: similar for any arm, so they show how the clocks are related."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.match.dwells import Thinned
from kilter_files.tables.joint_log import JointLog

GRID_HZ = 50.0
APART_S = 0.3


@dataclass(frozen=True)
class Likeness:
    """Lags (log time - recording time, s), what each scores, and the correlation of the speeds at the best."""

    lags_s: Floats
    scores: Floats
    correlation: float

    @property
    def best_s(self) -> float:
        """The lag that scores most."""
        return float(self.lags_s[int(np.argmax(self.scores))])

    def peaks(self, most: int) -> list[float]:
        """Return the lags of the highest scores, each at least 0.3 s from the others."""
        out: list[float] = []
        width = round(APART_S * GRID_HZ)
        order = np.argsort(self.lags_s)
        scores, lags = self.scores[order], self.lags_s[order]
        while len(out) < most and np.isfinite(best := scores.max()) and best > 0:
            k = int(np.argmax(scores))
            out.append(float(lags[k]))
            scores[max(0, k - width) : k + width + 1] = -np.inf
        return out


def likeness(thinned: Thinned, log: JointLog) -> Likeness:
    """Correlate the two speeds over all lags at which a quarter of the shorter one overlaps."""
    assert log.t_s is not None
    ours = np.arange(thinned.t_s[0], thinned.t_s[-1], 1 / GRID_HZ)
    theirs = np.arange(log.t_s[0], log.t_s[-1], 1 / GRID_HZ)
    a, b = even(np.interp(ours, *marker_speed(thinned))), even(np.interp(theirs, log.t_s, joint_speed(log)))
    size = len(a) + len(b)
    together = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    lags = np.arange(size)
    lags[lags >= len(b)] -= size
    overlap = np.minimum(len(b), lags + len(a)) - np.maximum(0, lags)
    score = np.where(overlap >= min(len(a), len(b)) / 4, together / np.sqrt(len(a) * len(b)), -np.inf)
    best = int(np.argmax(score))
    first, second = max(0, lags[best]), max(0, -lags[best])
    n = int(overlap[best])
    part = np.corrcoef(a[second : second + n], b[first : first + n])[0, 1] if n > 2 else 0.0
    return Likeness(theirs[0] - ours[0] + lags / GRID_HZ, score, float(np.nan_to_num(part)))


def marker_speed(thinned: Thinned) -> tuple[Floats, Floats]:
    """Return times and the median marker's speed, mm/s."""
    step = np.linalg.norm(np.diff(thinned.points_mm, axis=0), axis=2)
    known = ~np.isnan(step).all(axis=1)
    return (thinned.t_s[1:] + thinned.t_s[:-1])[known] / 2, np.nanmedian(step[known], axis=1) / thinned.step_s


def joint_speed(log: JointLog) -> Floats:
    """Return how fast the joints go together at each row, deg/s."""
    assert log.t_s is not None
    return np.asarray(np.linalg.norm(np.gradient(log.q_even(), log.t_s, axis=0), axis=1))


def even(speed: Floats) -> Floats:
    """Root of the speed, without mean, at size one: slow motions count too."""
    root = np.sqrt(np.clip(speed, 0, np.quantile(speed, 0.98) if len(speed) else 0))
    centred = root - root.mean()
    return np.asarray(centred / max(float(centred.std()), 1e-12))
