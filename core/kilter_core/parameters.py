"""Named parameters: unit, prior and physical range; the packing of a subset of them into a vector; their units in reports.

Reports, messages and documents have mm and degrees; whatever else the core has is in SI units and radians.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from statistics import NormalDist
from typing import Any, TypeVar

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.types import Bools, Floats, Ints

# Why a prior at all: without one a rank-deficient fit wandered to 1e13. These widths hold for machined arms; the data
# outweigh them a thousandfold wherever they see the parameter.
LENGTH_PRIOR_M = 0.005
ANGLE_PRIOR_RAD = 0.02
MM, DEG = 1e3, 180.0 / math.pi  # of them in a metre and in a radian
_REPORTED = {"m": ("mm", MM), "rad": ("deg", DEG), "rad/(N m)": ("deg/(N m)", DEG), "m/N": ("mm/N", MM)}

T = TypeVar("T", float, Floats)


def display_unit_and_scale(unit: str) -> tuple[str, float]:
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


ROUNDING = 1e-9  # of the end of a range


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
        """Whether ``value`` lies in the physical range, but for rounding: what is fitted to zero has any sign."""
        slack = ROUNDING * min(
            (abs(end) for end in (self.lower, self.upper) if end and math.isfinite(end)), default=0.0
        )
        return self.lower - slack <= value <= self.upper + slack


@dataclass(frozen=True)
class CorrelatedPrior:
    """What others say of parameters ``names``, SI: normal about ``mean (K,)`` with ``covariance (K, K)``.

    Others are arms of the type, or torques of the arm itself. It stands in place of each parameter's own prior. ``freedom``
    is that of the covariance: fewer arms, less sure of it. ``untold`` parameters none of them could tell.
    """

    names: tuple[str, ...]
    mean: Floats
    covariance: Floats
    freedom: float = math.inf
    untold: tuple[str, ...] = ()

    def widen_by_factor(self, by: float) -> CorrelatedPrior:
        """The same with standard deviations ``by`` times as large."""
        return replace(self, covariance=self.covariance * by**2)

    def widen_parameters(self, names: Sequence[str], by: float) -> CorrelatedPrior:
        """The same with standard deviations ``by`` times as large of these parameters alone."""
        factor = np.where(np.isin(self.names, list(names)), by, 1.0)
        return replace(self, covariance=self.covariance * np.outer(factor, factor))

    def restrict_to_identifiable(self) -> CorrelatedPrior:
        """The same of those parameters alone that arms of the type could tell."""
        own = np.array([k for k, name in enumerate(self.names) if name not in self.untold], dtype=np.int64)
        names = tuple(self.names[k] for k in own)
        return CorrelatedPrior(names, self.mean[own], self.covariance[np.ix_(own, own)], self.freedom)

    def places(self, names: Sequence[str]) -> tuple[Ints, Ints]:
        """Where those of ``names`` are that it knows, and where they are in its own."""
        own = {name: k for k, name in enumerate(self.names)}
        known = [k for k, name in enumerate(names) if name in own]
        return np.array(known, dtype=np.int64), np.array([own[names[k]] for k in known], dtype=np.int64)


@dataclass(frozen=True)
class Prior:
    """What is known of parameters before any row: normal about ``mean (F,)`` with standard deviations ``sigma (F,)``, SI.

    ``correlation (F, F)`` is theirs; None where they know nothing of each other.
    """

    mean: Floats
    sigma: Floats
    correlation: Floats | None = None

    @staticmethod
    def from_parameters(parameters: Sequence[Parameter], *told: CorrelatedPrior | None) -> Prior:
        """The parameters' own, and in place of it what is ``told`` of some of them."""
        mean, sigma = (np.array([getattr(p, part) for p in parameters]) for part in ("value", "prior_sigma"))
        correlation = None
        for one in told:
            if one is None:
                continue
            known, own = one.places([p.name for p in parameters])
            mean[known], sigma[known] = one.mean[own], np.sqrt(np.diag(one.covariance)[own])
            correlation = np.eye(len(mean)) if correlation is None else correlation
            correlation[np.ix_(known, known)] = one.covariance[np.ix_(own, own)] / np.outer(sigma[known], sigma[known])
        return Prior(mean, sigma, correlation)

    def append_prior(self, other: Prior) -> Prior:
        """Both, those of ``other`` after these; neither knows of the other."""
        mean, sigma = np.concatenate([self.mean, other.mean]), np.concatenate([self.sigma, other.sigma])
        if self.correlation is None and other.correlation is None:
            return Prior(mean, sigma)
        split, correlation = len(self.mean), np.eye(len(mean))
        for part, one in ((slice(split), self), (slice(split, None), other)):
            if one.correlation is not None:
                correlation[part, part] = one.correlation
        return Prior(mean, sigma, correlation)

    def select_parameters(self, which: Bools) -> Prior:
        """What it says of some alone, whatever the others are."""
        correlation = None if self.correlation is None else self.correlation[np.ix_(which, which)]
        return Prior(self.mean[which], self.sigma[which], correlation)

    @property
    def covariance(self) -> Floats:
        """Covariance (F, F), SI."""
        return np.outer(self.sigma, self.sigma) * (
            np.eye(len(self.sigma)) if self.correlation is None else self.correlation
        )

    @cached_property
    def precision(self) -> Floats | None:
        """Inverse of the correlation (F, F), in standard deviations; None where that is the identity."""
        return None if self.correlation is None else np.asarray(np.linalg.inv(self.correlation))

    def standardized_deviation(self, values: Floats) -> Floats:
        """How far ``values (F,)`` are from the mean, in standard deviations (F,)."""
        return np.asarray((values - self.mean) / self.sigma)

    def stiff(self, away: Floats) -> Floats:
        """How it pulls back (F,) what is ``away (F,)``, in standard deviations."""
        return away if self.precision is None else np.asarray(self.precision @ away)

    def columns(self, J: Floats) -> Floats:
        """Columns (..., F) by parameters turned into as many by standard deviations that know nothing of each other."""
        scaled = J * self.sigma
        return scaled if self._root is None else np.asarray(scaled @ self._root)

    def whiten_deviation(self, away: Floats) -> Floats:
        """The ``away (F,)`` in those: with :meth:`columns` it moves the same."""
        return away if self._root is None else np.asarray(np.linalg.solve(self._root, away))

    def add_to(self, H: Floats) -> None:
        """Add what it knows to an information matrix (F, F) in standard deviations."""
        if self.precision is None:
            H.flat[:: len(H) + 1] += 1.0
        else:
            H += self.precision

    @cached_property
    def _root(self) -> Floats | None:
        """Lower root (F, F) of the correlation."""
        return None if self.correlation is None else np.asarray(np.linalg.cholesky(self.correlation))


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


@dataclass(frozen=True)
class FittedNumber:
    """A number with a covariance: its name, SI unit and ``value``, and the values that physics allows.

    ``log`` says that the covariance is that of its logarithm.
    """

    name: str
    unit: str
    value: float
    log: bool = False
    low: float = -math.inf
    high: float = math.inf

    @property
    def key(self) -> str:
        """Name with its unit: ``j1.damping_nm_s_rad``."""
        unit = re.sub(r"[^a-z0-9]+", "_", self.unit.lower().replace("n m", "nm")).strip("_")
        return self.name if unit == "1" else f"{self.name}_{unit}"

    def bring_back(self, x: Floats) -> Floats:
        """Values where the covariance is, as values of the number."""
        return np.clip(np.exp(x) if self.log else x, self.low, self.high)


DRAWS = 100


def draw_ranges(
    numbers: Sequence[FittedNumber], covariance: Floats, level: float, draws: int = DRAWS, seed: int = 0
) -> dict[str, Any]:
    """Return the range of each number at a ``level`` (0 to 1), and ``draws`` of all of them together, SI.

    Raises:
        OptionError: a level that is not between 0 and 1.

    """
    if not 0.0 < level < 1.0:
        raise OptionError(
            f"A range cannot cover {100.0 * level:g} %: say how much it is to cover, as 95.", parameter="ranges"
        )
    centre = np.array([math.log(max(one.value, 1e-300)) if one.log else one.value for one in numbers])
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    half = NormalDist().inv_cdf(0.5 + 0.5 * level) * sigma
    scale = np.where(sigma > 0.0, sigma, 1.0)  # metres beside radians per newton metre: correlations keep their digits
    sizes, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    normal = np.random.default_rng(seed).normal(size=(draws, len(numbers)))
    samples = centre + scale * ((normal * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T)
    drawn = {one.key: one.bring_back(x) for one, x in zip(numbers, samples.T, strict=True)}
    ends = [one.bring_back(np.array([x - h, x + h])) for one, x, h in zip(numbers, centre, half, strict=True)]
    return {
        "level": level,
        "parameters": [
            {"name": one.key, "value": one.value, "low": float(low), "high": float(high)}
            for one, (low, high) in zip(numbers, ends, strict=True)
        ],
        "draws": [{key: float(values[k]) for key, values in drawn.items()} for k in range(draws)],
    }


def write_json_for_yaml(document: Mapping[str, Any]) -> str:
    """Write JSON whose numbers readers of YAML 1.1 read as numbers too: to them 1e-05 is a text, and 1.0e-05 a number."""
    text = json.dumps(document, indent=1, allow_nan=False)
    return re.sub(r"(?m)^(\s*(?:\"[^\"]*\": )?-?\d+)(e[-+]?\d+,?)$", r"\1.0\2", text) + "\n"
