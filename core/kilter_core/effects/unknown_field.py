"""Empirical tier: a smooth error field in the workspace that no known effect explains. A shape, not a cause."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import SHAPE
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class UnknownField(Effect):
    """The tool is shifted, along the base axes, by a polynomial of its nominal place p up to ``degree``.

    Of the linear part only the strain: its rotations belong to the base frame, as does the constant. p is divided by
    ``reach_m`` (the robot's own length when not given), so an amplitude is the shift in m at full reach.
    """

    id = "unknown_field"
    summary = "smooth error field in the workspace without a known cause"
    physical = SHAPE
    source = "empirical: strain and monomials of second degree of the tool point"
    aliases = ("measurement_scale", "thermal_growth", "base_compliance")
    remedy = "measure a grid of tool points, each reached with several postures of the arm"
    stage = "base"
    empirical = True
    at_joints = False

    degree: int = option(2, "Degree of the polynomial, 1 to 3.", low=1, high=3)
    reach_m: float | None = option(
        None, "Length by which positions are scaled, m, above 0; null: from the robot.", above=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.degree not in (1, 2, 3):
            raise OptionError(f"unknown_field has degree {self.degree!r}: give 1, 2 or 3.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Measure the robot's reach: the sum of its links and tool."""
        if self.reach_m is not None:
            return self
        reach = np.linalg.norm(robot.chain.link_vectors, axis=1).sum() + np.linalg.norm(robot.T_tool[:3, 3])
        return replace(self, reach_m=float(reach) or 1.0)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes, m: strains (``field_x_y`` is symmetric), then each component by monomial (``field_x_yz``)."""
        names = ["field_" + "xyz"[a] + "_" + "".join("xyz"[b] for b in powers) for a, powers in self._terms()]
        return tuple(Parameter(name, "m", 0.0, 5e-4, -0.01, 0.01, "shift at full reach") for name in names)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of the base frame and its derivatives by the amplitudes."""
        p = batch.tool_point / (self.reach_m or 1.0)
        shifts = np.zeros((len(self._terms()), len(batch), 6))
        for shift, (a, powers) in zip(shifts, self._terms(), strict=True):
            shift[:, a] = np.prod(p[:, powers], axis=1)
            if len(powers) == 1:
                shift[:, powers[0]] = p[:, a]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(shifts)])

    def _terms(self) -> list[tuple[int, tuple[int, ...]]]:
        """Component and factors of each term."""
        strains = [(a, (b,)) for a, b in combinations_with_replacement(range(3), 2)]
        higher = [c for degree in range(2, self.degree + 1) for c in combinations_with_replacement(range(3), degree)]
        return strains + [(a, powers) for powers in higher for a in range(3)]
