"""A line of a generated robot program, and what is known of it."""

from __future__ import annotations

from typing import NamedTuple

from .six_joint_arms import Floats


class Line(NamedTuple):
    """A line of a program, what it is, and the joints at which it was taught, deg; ``via`` are those on the way of an arc."""

    text: str
    what: str = "alone"
    q: Floats | None = None
    via: Floats | None = None
