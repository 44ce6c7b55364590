"""A carriage that leaves its line: a guide that is not straight moves it sideways along its travel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from kilter_core.effects.base import option
from kilter_core.effects.guide import GuideCurves
from kilter_core.effects.physical import GUIDE


@dataclass(frozen=True)
class Straightness(GuideCurves):
    """The carriage of prismatic joint i moves across its axis by a smooth curve of the reading, in x and y of the joint frame.

    A shift that is constant or proportional to the travel is geometry, so the orders begin at 2. The name says what the
    carriage does and not why: nothing needs to separate it from a cause.
    """

    id = "straightness"
    summary = "carriage of a prismatic joint moves across its axis along the travel"
    physical = GUIDE
    source = "ISO 230-1, straightness errors of a linear axis (EYX, EZX)"
    aliases = ("guide_rotation", "telescope_bending", "unknown_field")
    remedy = "run the carriage over its whole travel in small steps, in two postures of the joints behind it"
    lowest: ClassVar[int] = 2
    stem, components, sigma, wide = "straight", (0, 1), 1e-4, 5e-3

    orders: tuple[int, ...] = option((2, 3), "Orders of the polynomials over the range of the joint.")
