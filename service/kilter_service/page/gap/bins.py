"""Residuals in bins: the mean of each with its interval, beside the mean of the fitted curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

POINTS_PER_BIN, MOST = 6, 12  # points in a bin, and bins
TWO_SIDES = 0.4  # share of the ups and downs that must vanish when the two sides of a curve are parted
SMOOTH = 0.15  # ups and downs for each point, in ranges of the curve, below which it is a line over the angle
NORMAL = 1.959964


@dataclass(frozen=True)
class Point:
    """A visit: the angle, the residual there when the effect is taken out of the final model, and the fitted curve."""

    angle: float
    residual: float
    curve: float


@dataclass(frozen=True)
class Bin:
    """Mean residual of the points of a bin, half the width of its 95 % interval, and the mean of the curve there."""

    low: float
    high: float
    count: int
    angle: float
    mean: float
    half: float
    curve: float

    @property
    def agrees(self) -> bool:
        """Whether the curve lies within the interval."""
        return abs(self.curve - self.mean) <= self.half


def branches(points: Sequence[Point]) -> list[list[Point]]:
    """Part the points of an effect with two sides, such as a backlash: one angle has two values of its curve."""
    ordered = sorted(points, key=lambda point: point.angle)
    if not ordered:
        return []
    middle = (max(p.curve for p in ordered) + min(p.curve for p in ordered)) / 2
    sides = [[p for p in ordered if p.curve > middle], [p for p in ordered if p.curve <= middle]]
    if all(sides) and sum(map(_travel, sides)) < TWO_SIDES * _travel(ordered):
        return sides
    return [ordered]


def smooth(points: Sequence[Point]) -> bool:
    """Whether the curve is one line over the angle, which nothing else moves up and down."""
    height = max(p.curve for p in points) - min(p.curve for p in points)
    return _travel(points) <= max(6.0, SMOOTH * len(points)) * height


def _travel(points: Sequence[Point]) -> float:
    return sum(abs(b.curve - a.curve) for a, b in pairwise(points))


def bin_points(points: Sequence[Point]) -> list[Bin]:
    """Put points, ordered by angle, into bins of about as many each."""
    number = max(1, min(MOST, len(points) // POINTS_PER_BIN))
    edges = [round(k * len(points) / number) for k in range(number + 1)]
    return [_bin(points[a:b]) for a, b in pairwise(edges) if b - a > 1]


def _bin(points: Sequence[Point]) -> Bin:
    count = len(points)
    mean = math.fsum(p.residual for p in points) / count
    # The curve may rise within the bin: what scatters is the residual about it.
    rest = [p.residual - p.curve for p in points]
    middle = math.fsum(rest) / count
    spread = math.sqrt(math.fsum((r - middle) ** 2 for r in rest) / (count - 1))
    return Bin(
        points[0].angle, points[-1].angle, count, math.fsum(p.angle for p in points) / count, mean,
        student(count - 1) * spread / math.sqrt(count), math.fsum(p.curve for p in points) / count,
    )  # fmt: skip


def student(freedom: int) -> float:
    """Return the 97.5 % point of Student's distribution (Cornish and Fisher's expansion), within 1 % from 3 on."""
    z = NORMAL
    return (
        z
        + (z**3 + z) / (4 * freedom)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    )
