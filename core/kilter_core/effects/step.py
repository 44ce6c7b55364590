"""What happens once, between two rows: when that was, and which rows have the state before it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Effect, option
from kilter_core.effects.physical import Separator
from kilter_core.observations import Observations


@dataclass(frozen=True)
class Step(Effect):
    """Something jumped between two rows.

    Rows before ``at_s``, on their clock, or before ``at_row`` where no time is known, have the old state; all others,
    and rows of other days that say neither, have the new one, which is that of the geometry. A gap search places it.
    """

    source = "Quandt 1958; Bai and Perron 1998: a linear model whose parameters change at an unknown row"
    glances = frozenset({"t", "row"})
    event = True
    clock = "t"
    separated_by = (Separator.ORDER,)

    at_s: float | None = option(None, "When it happened, s on the clock of the rows.")
    at_row: int | None = option(None, "First row after it, counted from 1 as measured.")

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Put it in the middle of the rows where nothing says when it happened."""
        if rows is None or not len(rows) or self.at_s is not None or self.at_row is not None:
            return self
        if rows.t is not None:
            return replace(self, at_s=float(np.median(rows.t)))
        return self if rows.row is None else replace(self, at_row=int(np.median(rows.row)))

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """When it happened, s; it holds for ever."""
        return None if self.at_s is None else (self.at_s, None)
