"""Sums that data know where they do not tell the members: of two compliances about parallel axes, what both do together.

A move along a direction that the data do not see changes its members by known amounts. What such a move leaves as it is,
one member plus a multiple of another, may be known as well as any parameter (the estimable functions of linear models:
Searle 1971, Linear Models, 5.4).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import null_space

from kilter_core.identify.identifiable.identifiability import NullDirection, identifiable, own_members
from kilter_core.types import QUANTILE, Floats

SUREST = 1e-6  # of the unit: no more digits are written
SMALL = 1e-6  # of a prior sigma: a coefficient that is rounding
AXES = ("x", "y", "z")
FRAMES = ("base", "tool")
# The angles of a frame do not add, and what an angle does to its place is not linear: sums of lengths are told alone.
FRAME_TURNS = frozenset(f"{frame}_r{axis}" for frame in FRAMES for axis in AXES)
ALONG = 1e-9  # part of a frame's place that counts in a sum


@dataclass(frozen=True)
class Known:
    """What a fit says of its free parameters ``names``: ``values (F,)``, ``covariance (F, F)`` and ``prior_sigma (F,)``, SI.

    ``units`` are those of reports, each with how many of it one SI unit is. Covariances of base and tool are of increments
    along their own axes, their values are places: ``axes`` has the rotation (3, 3) of each frame that is not straight.
    ``fitted`` says whether there was a fit, or only a look at poses, whose values say nothing.
    """

    names: Sequence[str]
    values: Floats
    units: Sequence[tuple[str, float]]
    covariance: Floats
    prior_sigma: Floats
    axes: Mapping[str, Floats] = field(default_factory=dict)
    fitted: bool = True

    def sums(self, directions: Sequence[NullDirection]) -> list[list[dict[str, Any]]]:
        """Sums that the directions leave as they are, if the data know them; each stands at the last it has to do with.

        In units of reports: {parameters: [{name, coefficient}], value, unit, sigma, lower, upper, sentence}.
        """
        out: list[list[dict[str, Any]]] = [[] for _ in directions]
        for group in _group_by_shared_members(directions):
            names = sorted({n for k in group for n, _ in directions[k].weights}, key=self.names.index)
            if len(names) == len(group):
                continue
            at = [self.names.index(name) for name in names]
            moves = np.zeros((len(group), len(names)))
            for row, k in zip(moves, group, strict=True):
                members = [names.index(name) for name, _ in directions[k].weights]
                row[members] = np.array(directions[k].amounts) / self.prior_sigma[at][members]
            for g in own_members(null_space(moves).T):
                out[group[-1]] += self._sum(names, g / self.prior_sigma[at])
        return out

    def _sigma(self, at: Sequence[int], g: Floats) -> float:
        """Standard deviation of a sum. What the members cancel may leave less than rounding does, so roots are added."""
        scale = self.prior_sigma[at]
        roots, vectors = np.linalg.eigh(self.covariance[np.ix_(at, at)] / np.outer(scale, scale))
        return float(np.linalg.norm(np.sqrt(np.clip(roots, 0.0, None)) * (vectors.T @ (g * scale))))

    def _sum(self, names: Sequence[str], g: Floats) -> Iterator[dict[str, Any]]:
        kept = np.flatnonzero(np.abs(g) * self.prior_sigma[[self.names.index(n) for n in names]] > SMALL)
        names, g = [names[int(k)] for k in kept], g[kept] / g[kept[0]]
        at = [self.names.index(name) for name in names]
        sigma, prior = self._sigma(at, g), float(np.linalg.norm(g * self.prior_sigma[at]))
        if len(names) < 2 or not identifiable(np.array([sigma]), np.array([prior]))[0]:
            return
        if any(map(of_a_frame, names)) and (
            not FRAME_TURNS.isdisjoint(names) or len({self.units[k][0] for k in at}) > 1
        ):
            return
        unit, scale = self.units[at[0]]
        names, g = self._of_places(names, g)
        if not set(names) <= set(self.names):  # a coordinate of the place is held, and no longer written
            return
        at = [self.names.index(name) for name in names]
        value = float(g @ self.values[at])
        if not np.isfinite(value):
            return
        coefficients = [float(x) * scale / self.units[k][1] for x, k in zip(g, at, strict=True)]
        value, sigma = value * scale, sigma * scale
        lower, upper = value - QUANTILE * sigma, value + QUANTILE * sigma
        terms = " ".join(_term(name, x) for name, x in zip(names, coefficients, strict=True)).removeprefix("+ ")
        yield {
            "parameters": [{"name": n, "coefficient": x} for n, x in zip(names, coefficients, strict=True)],
            "value": value,
            "unit": unit,
            "sigma": sigma,
            "lower": lower,
            "upper": upper,
            "sentence": self._sentence(terms, value, sigma, unit),
        }

    def _of_places(self, names: Sequence[str], g: Floats) -> tuple[list[str], Floats]:
        """A sum of increments along the axes of base and tool, as one of the coordinates of their places."""
        out = dict(zip(names, map(float, g), strict=True))
        for frame in [f for f in FRAMES if f in self.axes and any(name.startswith(f"{f}_") for name in names)]:
            increments = np.array([out.pop(f"{frame}_{axis}", 0.0) for axis in AXES])
            along = np.asarray(self.axes[frame]) @ increments
            places = {f"{frame}_{a}": float(x) for a, x in zip(AXES, along, strict=True) if abs(x) > ALONG}
            out = {**places, **out} if frame == "base" else {**out, **places}
        return list(out), np.array(list(out.values()))

    def _sentence(self, terms: str, value: float, sigma: float, unit: str) -> str:
        said = _as_sure_as(sigma)
        if not self.fitted:
            return f"Together these poses tell them: {terms} to {said(QUANTILE * sigma)} {unit} (95 %)."
        lower, upper = value - QUANTILE * sigma, value + QUANTILE * sigma
        return f"Together they are known: {terms} = {said(value)} {unit} (95 %: {said(lower)} to {said(upper)})."


def of_a_frame(name: str) -> bool:
    """Whether a parameter is of base or tool."""
    return name.startswith(tuple(f"{frame}_" for frame in FRAMES))


def _as_sure_as(sigma: float) -> Callable[[float], str]:
    """How to write numbers of which a standard deviation is known: with its first two digits."""
    places = max(0, 1 - int(np.floor(np.log10(max(sigma, SUREST)))))
    return lambda value: f"{value:.{places}f}"


def _term(name: str, coefficient: float) -> str:
    # A frame may stand metres away: of its place more digits count.
    digits = 6 if of_a_frame(name) else 3
    size, sign = f"{abs(coefficient):.{digits}g}", "+" if coefficient > 0.0 else "-"
    return f"{sign} {name}" if size == "1" else f"{sign} {size} {name}"


def _group_by_shared_members(directions: Sequence[NullDirection]) -> list[list[int]]:
    """Places of directions that share members, together."""
    groups: list[tuple[set[str], list[int]]] = []
    for k, direction in enumerate(directions):
        names, places = {name for name, _ in direction.weights}, [k]
        for one in [group for group in groups if group[0] & names]:
            groups.remove(one)
            names, places = names | one[0], one[1] + places
        groups.append((names, sorted(places)))
    return [places for _, places in groups]
