"""Shares with their bounds, and the rows of the table they stand in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta


@dataclass(frozen=True)
class Figure:
    """A share k of n with 95 % bounds (Clopper and Pearson), or a plain number when ``value`` is set.

    ``effective`` is the number of independent outcomes among the n, when several come from one pose.
    """

    title: str
    target: str
    k: int = 0
    n: int = 0
    value: float | None = None
    unit: str = ""
    effective: float | None = None

    @property
    def share(self) -> float:
        """k / n, nan without cases."""
        return self.k / self.n if self.n else math.nan

    def bounds(self) -> tuple[float, float]:
        """95 % bounds of the share."""
        if self.effective is None:
            return clopper_pearson(self.k, self.n)
        return clopper_pearson(self.share * self.effective, self.effective)

    def row(self) -> str:
        """A row of the table."""
        if self.value is not None:
            shown = "–" if math.isnan(self.value) else f"{self.value:.3g}{self.unit}"
            return f"| {self.title} | {self.target} | {shown} | {self.n or ''} | |"
        if not self.n:
            return f"| {self.title} | {self.target} | – | 0 | |"
        low, high = self.bounds()
        return f"| {self.title} | {self.target} | {self.share:.1%} ({self.k}) | {self.n} | {low:.1%} – {high:.1%} |"


def clopper_pearson(k: float, n: float, level: float = 0.95) -> tuple[float, float]:
    """Exact bounds of a share."""
    if n == 0:
        return 0.0, 1.0
    tail = (1.0 - level) / 2.0
    low = 0.0 if k <= 0 else float(beta.ppf(tail, k, n - k + 1))
    high = 1.0 if k >= n else float(beta.ppf(1.0 - tail, k + 1, n - k))
    return low, high


def share(title: str, target: str, outcomes: Sequence[bool]) -> Figure:
    """Share of outcomes that are true."""
    return Figure(title, target, sum(outcomes), len(outcomes))


def by_pose(title: str, target: str, poses: Sequence[tuple[int, int]]) -> Figure:
    """Share over ``poses`` of (inside, of), with bounds that know that what is seen at one pose hangs together."""
    k, n = sum(p[0] for p in poses), sum(p[1] for p in poses)
    if not n:
        return Figure(title, target)
    found = np.array(poses, dtype=np.float64)
    p = k / n
    variance = float(np.sum((found[:, 0] - p * found[:, 1]) ** 2)) / n**2
    chance = p * (1.0 - p) / n
    effective = n * min(1.0, chance / variance) if variance > 0.0 and chance > 0.0 else float(len(poses))
    return Figure(title, target, k, n, effective=effective)
