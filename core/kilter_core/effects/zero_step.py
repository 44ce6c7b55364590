"""Zero of one joint that jumped once: a knock, a coupling that slipped, an encoder that lost counts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Batch, Effect, Local, option
from kilter_core.effects.physical import JOINT_ZERO
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ZeroStep(Effect):
    """The zero of a joint jumped by d between two rows: dq was less by d before it.

    Rows before ``at_s``, on their clock, or before ``at_row`` where no time is known, have the old zero; all others,
    and rows of other days that say neither, have the new one, which is that of the geometry. A gap search places it.
    """

    id = "zero_step"
    summary = "zero of a joint jumped once, between two rows"
    physical = JOINT_ZERO
    source = "Quandt 1958; Bai and Perron 1998: a linear model whose parameters change at an unknown row"
    stage = "joint"
    aliases = ("zero_drift", "zero_thermal", "base_step")
    remedy = "measure again without what came before it, and find out what knocked or slipped"
    glances = frozenset({"t", "row"})
    event = True

    at_s: float | None = option(None, "When it happened, s on the clock of the rows.")
    at_row: int | None = option(None, "First row after it, counted from 1 as measured.")

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Put it in the middle of the rows where nothing says when it happened."""
        if rows is None or not len(rows) or self.at_s is not None or self.at_row is not None:
            return self
        if rows.t is not None:
            return replace(self, at_s=float(np.median(rows.t)))
        return self if rows.row is None else replace(self, at_row=int(np.median(rows.row)))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jump d per joint, rad."""
        return self.per_joint(robot, "zero_step", "rad", 5e-3, -0.2, 0.2, "jump of the joint's zero")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by the jump."""
        before = -batch.before(self.at_s, self.at_row)
        return self.joint_angle(batch, values, np.broadcast_to(before[:, None], batch.q.shape))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add nothing: what moves now does so after it."""
        return True
