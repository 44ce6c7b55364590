"""Length of a single link that changes with time: it warms, or cools, where no thermometer is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Derivative, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_time import LawOfTime, settled_share, time_constants
from kilter_core.effects.physical import LINK_LENGTH, Separator
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SHORTEST_M = 1e-6


@dataclass(frozen=True)
class LinkLengthening(LawOfTime):
    """The link after joint i lengthens by r (t − t0) of its length or, with ``tau_s`` τ, by e (1 − exp(−(t − t0)/τ)).

    With a thermometer in the link it is ``link_growth``; one at the base does not follow the link's time constant.
    """

    id = "link_lengthening"
    summary = "length of one link changes with time"
    physical = LINK_LENGTH
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 230-3, thermal distortion after start-up; Yin et al. 2014: links beside motors warm up alone"
    aliases = ("settling", "link_growth", "zero_drift", "drift")
    remedy = "put a thermometer on the link, and revisit poses with it stretched out and folded back"

    tau_s: float | None = option(None, "Time constant, s, above 0; null: at a constant rate.", above=0.0)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """At a constant rate and, where rows have a time, settling at several paces."""
        if rows.t is None or not len(rows):
            return super().candidate_configurations(robot, rows)
        return [{}, *({"tau_s": tau} for tau in time_constants(float(np.ptp(rows.t))))]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Begin at the earliest row, at the links that have a length."""
        lengths = np.linalg.norm(robot.chain.link_vectors[:-1], axis=1)
        long = [int(j) for j in np.flatnonzero(lengths > SHORTEST_M)]
        return (
            super()
            .configure_for_robot(robot, rows)
            .restrict_to_joints(robot, long, "its link has no length. Name the joint before a long link.")
        )

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate r per link, 1/s, or strain e in the end, named with τ; 5e-4 is aluminium that warms by 20 K."""
        if self.tau_s is None:
            return self.per_joint(robot, "link_rate", "1/s", 1e-8, -1e-6, 1e-6, "rate of the link's strain")
        stem = f"link_strain_{self.tau_s:g}s"
        return self.per_joint(robot, stem, "1", 5e-5, -5e-4, 5e-4, "strain of the link in the end")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of each joint's frame along its link, and the derivative."""
        elapsed = self.elapsed_time(batch)
        course = elapsed if self.tau_s is None else settled_share(elapsed, self.tau_s)
        derivatives = []
        for k, j in enumerate(self.acting(batch.q.shape[1])):
            xi = np.zeros((len(batch), 6))
            xi[:, :3] = course[:, None] * batch.link_vectors[j]
            derivatives.append(Derivative(k, j, xi=xi))
        return linear(batch, values, derivatives)
