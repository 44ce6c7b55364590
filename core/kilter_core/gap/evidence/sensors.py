"""What a sensor at the place itself says of a named effect: an inclinometer on the base, an encoder on the link.

That a column is there proves nothing. The effect is fitted to the tool alone, and what the sensor must then read is compared
with what it reads: an arm that climbed with the clock got a drift a hundred times what its own inclinometer saw.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.effects.physical import JOINT_ZERO, STATION, THERMAL, joint_numbers
from kilter_core.gap.evidence.fits.final_fit import amounts
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.scan import residual_given
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import Floats

ALONE = 3.0  # standard deviations in which a sensor must show the effect, or must have been able to
ALIKE = 0.5  # share of what the tool says by which a reading may differ: its scale and its mounting are rough
AXES = 3  # channels of an inclinometer
SENSED = (STATION.id, JOINT_ZERO.id, THERMAL.id)


@dataclass(frozen=True)
class Sensed:
    """By how much an effect rotates the place of a ``sensor`` as the tool says (rad or m, largest change), and what it reads.

    ``slope`` is what is read over what the tool says, ``read`` its standard deviation by the readings and ``known`` that
    by what the tool tells.
    """

    sensor: str
    expected: float
    slope: float
    read: float
    known: float
    slides: bool = False

    @property
    def sigma(self) -> float:
        """Standard deviation of the slope."""
        return float(np.hypot(self.read, max(1.0, abs(self.slope)) * self.known))

    @property
    def able(self) -> bool:
        """Whether the sensor would show an effect of this size."""
        return self.sigma * ALONE < 1.0

    @property
    def supports_effect(self) -> bool:
        """Whether it shows the effect, by sign and size."""
        return self.slope > ALONE * self.sigma and self._slope_error <= max(ALIKE, ALONE * self.sigma)

    @property
    def refutes_effect(self) -> bool:
        """Whether it would show the effect, and does not."""
        return self.able and self._slope_error > max(ALIKE, ALONE * self.sigma)

    @property
    def comparison_text(self) -> str:
        """Both numbers in words."""
        unit, scale = display_unit_and_scale("m" if self.slides else "rad")
        size = scale * self.expected
        shown, said = with_sigma(self.slope * size, self.read * size), with_sigma(size, self.known * size)
        return f"{self.sensor} shows {shown} {unit} where the tool says {said} {unit}"

    @property
    def _slope_error(self) -> float:
        return abs(self.slope - 1.0)


def with_sigma(value: float, sigma: float) -> str:
    """A value and its standard deviation, for people, to the first digit of that."""
    digits = max(0, -math.floor(math.log10(max(sigma, 1e-9))))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def compare_with_sensor(search: SearchResult, place: int) -> Sensed | None:
    """Compare the readings with a chosen candidate; None where no sensor sits where it acts, or it rotates nothing there."""
    problem, candidate = search.problem, search.selector.scorer.candidates[place]
    source, columns = problem.settings.source, list(candidate.columns)
    channels = _channels(search, candidate)
    if not len(channels):
        return None
    amount, covariance = _by_tool(search, place)
    W = source.without_geometry().linear(problem.values, None, columns).W
    by = W[:, channels].reshape(-1, len(columns))
    read = source.residual(problem.values)[:, channels].reshape(-1) + by @ source.library(problem.values)[columns]
    used = np.repeat(problem.settings.used, len(channels)) & np.isfinite(read)
    told, read, by = (by @ amount)[used], read[used], by[used]
    size = float(told @ told)
    if size <= 0.0 or len(read) < 2 * len(channels):
        return None
    slope = float(told @ read) / size
    scatter = float(np.sum((read - slope * told) ** 2)) / max(len(read) - 1, 1)
    along = by.T @ told
    read_sigma, known = np.sqrt(max(scatter, 1e-300) / size), np.sqrt(float(along @ covariance @ along)) / size
    where = [np.ptp((W[:, k] @ amount)[problem.settings.used]) for k in channels]
    slides = candidate.joints is not None and all(
        source.model.robot.joints[j].kind == "prismatic" for j in candidate.joints
    )
    return Sensed(_name(candidate), float(np.linalg.norm(where)), slope, float(read_sigma), float(known), slides)


def _channels(search: SearchResult, candidate: Candidate) -> list[int]:
    """Numbers of a visit that sensors read where a candidate acts."""
    source = search.problem.settings.source
    if not source.tool_numbers or not source.observes_tool or candidate.effects[0].physical.id not in SENSED:
        return []
    rows, n = source.observations, source.model.robot.n_joints
    seen = np.any(~np.isnan(source.residual(search.problem.values)), axis=0).tolist()
    if candidate.joints is not None:
        numbers: Sequence[int] = [source.tool_numbers + j for j in candidate.joints] if rows.link_q is not None else []
    elif rows.tilt is not None and rows.tilt.shape[1] > n:
        numbers = range(len(seen) - AXES, len(seen))  # the base comes last
    else:
        numbers = []
    return [k for k in numbers if seen[k]] if candidate.joints is None or all(seen[k] for k in numbers) else []


def _by_tool(search: SearchResult, place: int) -> tuple[Floats, Floats]:
    """Parameters (K,) of a candidate by the tool's numbers alone, with its prior, and their covariance (K, K)."""
    problem: LinearizedProblem = search.problem
    columns = list(search.selector.scorer.candidates[place].columns)
    rest = search.selector.columns([k for k in search.chosen if k != place])
    basis = problem.basis(rest)
    W = problem.projected_columns(columns)
    X = W - basis @ (basis.T @ W)
    size = problem.settings.whitener.shape[-1]
    tool = np.arange(len(X)) % size < problem.settings.source.tool_numbers
    X, r = X[tool], residual_given(problem, rest, basis)[tool]
    amount, covariance = amounts(search, columns, X, r)
    scale = problem.scale[columns]
    return scale * amount, covariance * np.outer(scale, scale)


def _name(candidate: Candidate) -> str:
    if candidate.joints is None:
        return "the inclinometer on the base"
    return f"the link encoder of {joint_numbers(candidate.joints)}"
