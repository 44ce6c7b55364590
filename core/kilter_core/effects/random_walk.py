"""Random walk of the base or of the instrument: it moves by itself, for no reason that is measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import STATION, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.observations.clock import applicable_time_mask, on_shared_clock
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

PIECES = 6
FEW_PIECES = (2, 3)
MOST_PIECES = 50
SPREAD = 2e-6  # m per root of a second: 0.12 mm in an hour


@dataclass(frozen=True)
class RandomWalk(Effect):
    """The base frame moves along its axes, straight on between the times ``knots_s``; it is at rest at the first of them.

    The steps from knot to knot are the parameters, independent of one another, each with a prior whose variance grows
    with the time it takes, as of a Wiener process. Without ``knots_s`` there are ``pieces`` that hold as many rows each;
    a gap job tries few and many, because a slow walk shows in few, and each piece costs what three parameters cost.
    """

    id = "random_walk"
    summary = "base or instrument wanders with time"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "Wiener process as prior of a pose; Barfoot, State Estimation for Robotics, 3.4"
    needs = frozenset({"t"})
    clock = "t"
    stage = "base"
    aliases = ("drift", "settling", "session_shift")
    remedy = "revisit a reference pose between the others, and visit those in random order"
    at_joints = False
    supple = True

    knots_s: tuple[float, ...] = option(
        (),
        "Times between which the base goes straight on, s; empty: as many pieces as `pieces` says, with as many rows each.",
    )
    pieces: int = option(PIECES, "How many pieces, 1 to 50.", low=1, high=MOST_PIECES)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.pieces <= MOST_PIECES:
            raise OptionError(f"random_walk has pieces {self.pieces}: give 1 to {MOST_PIECES}.", effect=self.id)
        if len(self.knots_s) == 1 or any(b <= a for a, b in pairwise(self.knots_s)):
            raise OptionError("random_walk needs two or more knots_s, each later than the one before.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """In few pieces and in many."""
        return [{"pieces": n} for n in (*FEW_PIECES, PIECES)]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Put the knots where the rows are."""
        if self.knots_s or rows is None or rows.t is None or not np.ptp(rows.t) > 0.0:
            return self
        shared = on_shared_clock(rows.t)
        own = rows.t[shared] if shared.any() else rows.t
        knots = np.unique(np.quantile(own, np.linspace(0.0, 1.0, self.pieces + 1)))
        return replace(self, knots_s=tuple(float(t) for t in knots))

    @property
    def informative_row_share(self) -> float:
        """Of many pieces a step is told by its own. Few are a bent line, which all rows tell as they do a rate of drift."""
        return 1.0 / max(len(self.knots_s) - 1, 1) if self.pieces >= PIECES else 1.0

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Steps along x, y, z, m, piece by piece.

        Raises:
            OptionError: no knots, and no rows to take them from.

        """
        if not self.knots_s:
            raise OptionError(
                "random_walk needs knots_s: give times in s, or rows whose t_s differ to take them from.",
                effect=self.id,
            )
        stem = "walk" if self.pieces == PIECES else f"walk{self.pieces}"
        made = []
        for n, (begin, end) in enumerate(pairwise(self.knots_s), 1):
            sigma = SPREAD * math.sqrt(end - begin)
            text = f"step of the base in piece {n} along "
            made += [
                Parameter(f"{stem}_{n}_{k}", "m", 0.0, sigma, -10.0 * sigma, 10.0 * sigma, text + k) for k in "xyz"
            ]
        return tuple(made)

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """First and last knot, s."""
        return (self.knots_s[0], self.knots_s[-1]) if self.knots_s else None

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the steps."""
        first, last = self.knots_s[0], self.knots_s[-1]
        t = np.asarray(self.column(batch, "t"), dtype=np.float64)
        t = np.where(applicable_time_mask(t, first, last), t, first)
        done = [np.clip((t - begin) / (end - begin), 0.0, 1.0) for begin, end in pairwise(self.knots_s)]
        moved = [axis * part[:, None] for part in done for axis in np.eye(6)[:3]]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])
