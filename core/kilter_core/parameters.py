"""Named parameters: unit, prior and physical range; the packing of a subset of them into a vector; their units in reports.

Reports, messages and documents have mm and degrees; whatever else the core has is in SI units and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TypeVar

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.types import Floats, Ints

# Why a prior at all: without one a rank-deficient fit wandered to 1e13. These widths hold for machined arms; the data
# outweigh them a thousandfold wherever they see the parameter.
LENGTH_PRIOR_M = 0.005
ANGLE_PRIOR_RAD = 0.02
MM, DEG = 1e3, 180.0 / math.pi  # of them in a metre and in a radian
_REPORTED = {"m": ("mm", MM), "rad": ("deg", DEG), "rad/(N m)": ("deg/(N m)", DEG), "m/N": ("mm/N", MM)}

T = TypeVar("T", float, Floats)


def reported(unit: str) -> tuple[str, float]:
    """Return the unit that reports have for an SI unit, and how many of it one of those is."""
    return _REPORTED.get(unit, (unit, 1.0))


def mm(metres: T) -> T:
    """Return a length in mm."""
    return metres * MM


def degrees(radians: T) -> T:
    """Return an angle in degrees."""
    return radians * DEG


def metres(of_mm: float) -> float:
    """Return a length that was stated in mm in m."""
    return of_mm / MM


@dataclass(frozen=True)
class Parameter:
    """One number to identify: ``unit`` in SI ("m", "rad", "rad/(N m)", "1"), Gaussian prior ``value ± prior_sigma``."""

    name: str
    unit: str
    value: float = 0.0
    prior_sigma: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""

    def plausible(self, value: float) -> bool:
        """Whether ``value`` lies in the physical range."""
        return self.lower <= value <= self.upper


def indices(names: Sequence[str], wanted: Iterable[str]) -> Ints:
    """Positions of ``wanted`` in ``names``.

    Raises:
        OptionError: a name that does not exist; the nearest ones are offered.

    """
    place = {name: k for k, name in enumerate(names)}
    found = []
    for name in wanted:
        if name not in place:
            near = get_close_matches(name, names, n=3) or list(names[:5])
            raise OptionError(
                f"There is no parameter {name!r} in this model. Near it: {', '.join(near)}.", parameter=name, near=near
            )
        found.append(place[name])
    return np.asarray(found, dtype=np.int64)


def refuse_collisions(names: Sequence[str]) -> None:
    """Raise :class:`OptionError` when two parameters share a name."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise OptionError(f"Two parameters are named {name!r}: rename one of them.", parameter=name)
        seen.add(name)
