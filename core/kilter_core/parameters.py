"""Named parameters: unit, prior and physical range; the packing of a subset of them into a vector; their units in reports.

Reports, messages and documents have mm and degrees; whatever else the core has is in SI units and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class TypePrior:
    """What other arms of a type say of parameters ``names``, SI: normal about ``mean (K,)`` with ``covariance (K, K)``.

    It stands in place of each parameter's own prior. ``freedom`` is that of the covariance: fewer arms, less sure of it.
    ``untold`` parameters none of the arms could tell: of those it says nothing.
    """

    names: tuple[str, ...]
    mean: Floats
    covariance: Floats
    freedom: float
    untold: tuple[str, ...] = ()

    def widened(self, by: float) -> TypePrior:
        """The same with standard deviations ``by`` times as large."""
        return replace(self, covariance=self.covariance * by**2)

    def loosened(self, names: Sequence[str], by: float) -> TypePrior:
        """The same with standard deviations ``by`` times as large of these parameters alone."""
        factor = np.where(np.isin(self.names, list(names)), by, 1.0)
        return replace(self, covariance=self.covariance * np.outer(factor, factor))

    def told(self) -> TypePrior:
        """The same of those parameters alone that arms of the type could tell."""
        own = np.array([k for k, name in enumerate(self.names) if name not in self.untold], dtype=np.int64)
        names = tuple(self.names[k] for k in own)
        return TypePrior(names, self.mean[own], self.covariance[np.ix_(own, own)], self.freedom)

    def alone(self, names: Sequence[str], mean: Floats, sigma: Floats) -> tuple[Floats, Floats]:
        """Mean and standard deviations (F,) of parameters ``names``, each by itself, as in :meth:`over`."""
        known, own = self.places(names)
        mean, sigma = mean.copy(), sigma.copy()
        mean[known], sigma[known] = self.mean[own], np.sqrt(np.diag(self.covariance)[own])
        return mean, sigma

    def places(self, names: Sequence[str]) -> tuple[Ints, Ints]:
        """Where those of ``names`` are that it knows, and where they are in its own."""
        own = {name: k for k, name in enumerate(self.names)}
        known = [k for k, name in enumerate(names) if name in own]
        return np.array(known, dtype=np.int64), np.array([own[names[k]] for k in known], dtype=np.int64)

    def over(self, names: Sequence[str], mean: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats]:
        """Mean (F,), standard deviations (F,) and precision (F, F) in these, of parameters ``names``.

        ``mean`` and ``sigma (F,)`` are those of their own priors, which those keep that it does not know.
        """
        known, own = self.places(names)
        mean, sigma = self.alone(names, mean, sigma)
        precision, C = np.eye(len(names)), self.covariance[np.ix_(own, own)]
        precision[np.ix_(known, known)] = np.linalg.inv(C / np.outer(sigma[known], sigma[known]))
        return mean, sigma, precision


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
