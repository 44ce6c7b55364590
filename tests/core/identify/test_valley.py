"""The solver along a steep valley that bends, as constants of a chain make it that the tool's frame makes up for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.identify.fit.solver import BEND, minimise

Floats = NDArray[np.float64]

STEEP = 1e6  # how much steeper across than along
RADIUS = 3.0
PRIOR = np.array([2.0, -1.5])  # where a weak pull wants to be; the floor of the valley is a circle about the origin


@dataclass(frozen=True)
class Seen:
    """Residual across the valley, its slope, and the loss with the prior."""

    r: float
    J: Floats
    loss: float


class Valley:
    """Minimise the distance from a circle, steeply, and from PRIOR, weakly."""

    rows = 1.0

    def __init__(self) -> None:
        self.asked = 0

    def required_decrease(self, loss: float) -> float:
        return 0.0

    def evaluate(self, values: Floats) -> Seen:
        self.asked += 1
        radius = float(np.linalg.norm(values))
        r = STEEP * (RADIUS - radius)
        away = values - PRIOR
        return Seen(r, STEEP * values / radius, 0.5 * (r * r + float(away @ away)))

    def surely_higher(self, values: Floats, loss: float) -> bool:
        return False

    def derivatives(self, values: Floats, here: Seen) -> tuple[Floats, Floats]:
        return np.outer(here.J, here.J) + np.eye(2), self.slope(values, here)

    def slope(self, values: Floats, here: Seen) -> Floats:
        return here.J * here.r - (values - PRIOR)

    def apply_step(self, values: Floats, step: Floats) -> Floats:
        return values + step

    def bend(self, values: Floats, here: Seen, step: Floats) -> Floats:
        r = STEEP * (RADIUS - float(np.linalg.norm(values + BEND * step)))
        return np.asarray(here.J * (here.r - r - here.J @ (BEND * step)) * (2.0 / BEND**2))

    def beyond(self, here: Seen, values: Floats, step: Floats) -> Seen:
        r, away = here.r - float(here.J @ step), values - PRIOR
        return Seen(r, here.J, 0.5 * (r * r + float(away @ away)))


@pytest.mark.parametrize("angle", [0.4, 1.0, 1.6])
def test_a_valley_that_bends_is_followed_in_a_few_steps(angle: float) -> None:
    valley, start = Valley(), RADIUS * np.array([np.cos(angle), np.sin(angle)])
    found = minimise(valley, start, valley.evaluate(start))
    assert found.converged
    np.testing.assert_allclose(found.values, RADIUS * PRIOR / np.linalg.norm(PRIOR), atol=1e-3)
    assert valley.asked < 40


class Cheap(Valley):
    """The same, whose loss is known without derivatives."""

    def surely_higher(self, values: Floats, loss: float) -> bool:
        r, away = STEEP * (RADIUS - float(np.linalg.norm(values))), values - PRIOR
        return 0.5 * (r * r + float(away @ away)) > loss * (1.0 + 1e-9)


@pytest.mark.parametrize("radius", [0.3, 3.0])
def test_derivatives_are_not_taken_where_a_shorter_step_still_climbs(radius: float) -> None:
    start = radius * RADIUS * np.array([np.cos(2.9), np.sin(2.9)])
    valley, cheap = Valley(), Cheap()
    found = [minimise(one, start, one.evaluate(start)).values for one in (valley, cheap)]
    np.testing.assert_array_equal(*found)
    assert cheap.asked < valley.asked


class Vain(Valley):
    """The same, whose loss hardly falls whatever its slope promises."""

    def required_decrease(self, loss: float) -> float:
        return 1e-9

    def evaluate(self, values: Floats) -> Seen:
        seen = super().evaluate(values)
        return Seen(seen.r, seen.J, 1e-6 * seen.loss)


def test_a_walk_ends_after_steps_that_gain_nothing_worth_taking() -> None:
    start = RADIUS * np.array([np.cos(2.9), np.sin(2.9)])
    found = [minimise(valley, start, valley.evaluate(start), idle=idle) for valley, idle in ((Vain(), 2), (Vain(), 60))]
    assert found[0].iterations == 2 < found[1].iterations
