"""Whether a camera or a board was bumped half-way: its places before and after, which a fit takes for one, averaged.

What a step of its place takes off the squares of what views leave, with all parameters following, is scored at every place
between two views, by sums along the order of measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import f

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.plausibility.views.view_residuals import NUMBERS, Part, ViewResiduals
from kilter_core.observations.clock import read_clock
from kilter_core.parameters import degrees, mm
from kilter_core.types import QUANTILE, Bools, Floats, Ints

CHANCE = 1e-3  # of saying it of a rig that stood still, all parts and places together
SHARE = 0.3  # of what is left that the step must explain: an arm measured in order can look like a little of one
PER_SIDE = 4  # views on either side: fewer are wrong rows
SURE = 0.95  # of the interval of rows in which it happened
ALIKE = 1.3  # times what the best explanation leaves: parts that leave no more are named with it
RIDGE = 1e-9


@dataclass(frozen=True)
class Moved:
    """How far something moved: ``size`` m at the tool (rms) and ``turn`` rad, each with its standard deviation."""

    size: tuple[float, float]
    turn: tuple[float, float]

    @property
    def clear(self) -> bool:
        """Whether it is more than chance with the part in two places."""
        return any(value > QUANTILE * sigma for value, sigma in (self.size, self.turn))


@dataclass(frozen=True)
class Step:
    """A part that moved before view ``at`` of those in order; ``first`` and ``last`` view that may be the first after it.

    It explains a ``share`` of the squares that views leave, by ``chance``, and leaves ``left``.
    """

    part: Part
    at: int
    first: int
    last: int
    chance: float
    share: float
    left: float


def steps(seen: ViewResiduals, order: Ints) -> list[Step]:
    """The best step of each part, the best part first; ``order`` are the views in the order of measurement."""
    seen = seen.only(order)
    found = [one for part in seen.parts if (one := _step(seen, part)) is not None]
    return sorted(found, key=lambda one: one.left)


def _step(seen: ViewResiduals, part: Part) -> Step | None:
    own = np.any(part.columns != 0.0, axis=(1, 2))
    before = np.cumsum(own) - own
    able = (before >= PER_SIDE) & (own.sum() - before >= PER_SIDE) & own
    if not able.any() or seen.freedom <= 2 * NUMBERS:
        return None
    B = part.columns
    H = _tail_sums(B.transpose(0, 2, 1) @ B)
    Z = _tail_sums(seen.A.transpose(0, 2, 1) @ B)
    c = _tail_sums(np.einsum("kij,ki->kj", B, seen.refitted_residuals))
    S = H - Z.transpose(0, 2, 1) @ (seen.parameter_covariance @ Z)
    size = np.sqrt(np.diagonal(H, axis1=1, axis2=2))
    size = np.where(able[:, None] & (size > 0.0), size, 1.0)
    S = S / (size[:, :, None] * size[:, None, :]) + RIDGE * np.eye(NUMBERS)
    inverse = np.linalg.inv(S) / (size[:, :, None] * size[:, None, :])
    gain = np.where(able, np.einsum("ki,kij,kj->k", c, inverse, c), 0.0)
    whole = float(np.sum(seen.refitted_residuals**2))
    k = int(np.argmax(gain))
    free = seen.freedom - NUMBERS
    variance = max(whole - float(gain[k]), 1e-9 * whole, 1e-30) / free
    chance = float(f.sf(float(gain[k]) / NUMBERS / variance, NUMBERS, free)) * int(able.sum()) * len(seen.parts)
    likely = np.exp(np.maximum(0.5 * (gain - gain[k]) / variance, -700.0)) * able
    sure = np.argsort(-likely, kind="stable")
    sure = sure[: int(np.searchsorted(np.cumsum(likely[sure]), SURE * likely.sum())) + 1]
    return Step(
        part, k, int(sure.min()), int(sure.max()), min(chance, 1.0), float(gain[k]) / max(whole, 1e-300),
        whole - float(gain[k]),
    )  # fmt: skip


def _tail_sums(each: Floats) -> Floats:
    """Sums over all from each place on."""
    return np.asarray(np.cumsum(each[::-1], axis=0)[::-1])


@dataclass(frozen=True)
class Found:
    """The best step of those that views show, and others that leave hardly more, of views in ``order``."""

    best: Step
    others: tuple[Step, ...]
    order: Ints

    @staticmethod
    def from_fit(fit: Fit, seen: ViewResiduals) -> Found | None:
        """What moved, beyond chance; None where nothing did."""
        rows = fit.problem.measurement.observations
        given = read_clock(rows).order if rows.row is None else np.argsort(rows.row, kind="stable")
        rank = np.empty(len(rows), dtype=np.int64)
        rank[given] = np.arange(len(rows))
        order = np.argsort(rank[seen.rows], kind="stable")
        found = steps(seen, order)
        if not found or found[0].chance > CHANCE or found[0].share < SHARE:
            return None
        best = found[0]
        others = tuple(one for one in found[1:] if one.left < ALIKE * best.left)
        return Found(best, others, seen.rows[order])

    def later(self, rows: int) -> Bools:
        """Which of so many fitted rows were measured after it."""
        out = np.zeros(rows, dtype=bool)
        out[self.order[self.best.at :]] = True
        return out


def camera_moved(found: Found, moved: Moved | None, numbers: Ints) -> dict[str, Any]:
    """The warning ``camera_moved``; ``numbers (N,)`` are those of the fitted rows among the ones given, from 0."""
    best, part = found.best, found.best.part
    last, row, first, latest = (
        int(numbers[found.order[k]]) + 1 for k in (max(best.at - 1, 0), best.at, best.first, best.last)
    )
    sure = "" if first == latest else f" (95 %: the first row after it is {first} to {latest})"
    far = ""
    sizes: dict[str, float | None] = dict.fromkeys(("moved_mm", "u95_mm", "rotated_deg", "u95_deg"))
    if moved is not None:
        size, half = mm(moved.size[0]), mm(QUANTILE * moved.size[1])
        turn, half_turn = float(degrees(moved.turn[0])), float(degrees(QUANTILE * moved.turn[1]))
        sizes = {"moved_mm": size, "u95_mm": half, "rotated_deg": turn, "u95_deg": half_turn}
        far = (
            f", by {size:.3g} mm at the tool (95 %: within {half:.1g} mm) and {turn:.2g} deg (within "
            f"{half_turn:.1g} deg)"
        )
    other = [f"{one.part.words[0].lower()}{one.part.words[1:]} did" for one in found.others]
    either = ", or ".join([*other, "the base of the robot did" if part.fixed else "the tool did"])
    what = "camera" if part.camera else "board"
    return {
        "code": "camera_moved", "part": what, "name": part.name, "row": row, "rows_95": [first, latest], **sizes,
        "p_value": best.chance,
        "message": f"{part.words} moved between rows {last} and {row}{sure}{far}, or {either}: this fit averages the places "
        f"before and after. Give the {what} another name from row {row} on (column `{what}`, and a second entry in "
        f"`{what}s`), and identify again: each place is then fitted by itself.",
    }  # fmt: skip
