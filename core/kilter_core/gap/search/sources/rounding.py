"""Rounded joint readings as noise: each is off by up to half a step, which the Jacobian carries to what was measured.

The variance of a joint is step² / 12 (Widrow, Kollar and Liu 1996). Repeats do not show it: a pose that is visited again
is rounded the same way again, so its visits share one error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.noise.visits import Visits
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.fit.problem import SharedErrors
from kilter_core.observations import Observations
from kilter_core.observations.repeats import numbered_rows
from kilter_core.observations.rounding import reading_steps
from kilter_core.parameters import DEG, MM, mm
from kilter_core.types import Bools, Floats, Ints

COUNTS = 0.25  # of the noise of a coordinate, below which rounding is not worth its weights
AS_LARGE = 0.7  # of what rounding gives, that the fit must leave: less says that the arm was where the readings are
ALIKE = 1e-9  # rad or m: readings nearer than this are one
HELD = 0.5  # share of repeats with another reading, from which their scatter holds the rounding


@dataclass(frozen=True)
class Rounding:
    """``steps (n,)`` of the readings, rad or m; ``by (V, m, n)`` what one sigma of each joint's moves of a visit's numbers.

    ``reading (V,)`` numbers the readings: visits of one share its error.
    """

    steps: Floats
    by: Floats
    reading: Ints

    @staticmethod
    def from_source(source: Source, values: Floats, steps: Floats) -> Rounding:
        """At a fit, by how each joint moves what was measured."""
        rows = source.observations
        seen = ~np.isnan(source.residual(values))
        column = source.joint_columns(values)
        joints = [np.nan_to_num(column(j)) * step / np.sqrt(12.0) for j, step in enumerate(steps)]
        by = np.stack(joints, axis=2) * seen[:, :, None]
        return Rounding(steps, by, number_readings(rows))

    @property
    def covariance(self) -> Floats:
        """Covariance (V, m, m) of a visit's numbers."""
        return np.asarray(self.by @ self.by.transpose(0, 2, 1))

    @property
    def row(self) -> Floats:
        """The same on average (m, m)."""
        return np.asarray(self.covariance.mean(axis=0))

    def alone(self, used: Bools) -> Floats:
        """Covariance (V, m, m) at the visits whose reading no other visit has; zero elsewhere."""
        count = np.bincount(self.reading[used], minlength=int(self.reading.max()) + 1)
        return np.where((count[self.reading] < 2)[:, None, None], self.covariance, 0.0)

    def shared_errors(self, whitener: Floats, used: Bools) -> SharedErrors:
        """What visits of one reading share, whitened by each one's own noise."""
        size = whitener.shape[-1]
        blocks = []
        visits = np.flatnonzero(used)[np.argsort(self.reading[used], kind="stable")]
        for own in np.split(visits, np.flatnonzero(np.diff(self.reading[visits])) + 1):
            if len(own) > 1:
                rows = (own[:, None] * size + np.arange(size)).reshape(-1)
                blocks.append((rows, (whitener[own] @ self.by[own]).reshape(len(rows), -1)))
        return SharedErrors.from_blocks(blocks)


def rounding(source: Source, values: Floats, q: Floats, visits: Visits, noise: Noise) -> tuple[Rounding | None, bool]:
    """Rounding of the readings ``q (N, n)`` where it counts beside the noise, and whether the noise holds it already.

    Where readings are commands that the arm obeyed, the fit leaves less than their rounding would give: none then.
    """
    steps = reading_steps(q, [joint.kind == "prismatic" for joint in source.model.robot.joints])
    if not np.any(steps) or not source.observes_tool or not source.observes_places:
        return None, False
    one = Rounding.from_source(source, values, steps)
    size = coordinate(one, source)
    left = source.residual(values)[:, : source.tool_numbers][:, : noise.lengths]
    if size < COUNTS * noise.coordinate or np.sqrt(np.nanmean(left**2)) < AS_LARGE * size:
        return None, False
    return one, not noise.absolute or (noise.repeats is not None and in_repeats(visits))


def number_readings(rows: Observations) -> Ints:
    """Number the readings (N,): rows of equal joint vectors share one."""
    return numbered_rows(np.round(rows.q / ALIKE).astype(np.int64))


def in_repeats(visits: Visits) -> bool:
    """Whether repeats were mostly rounded anew, so that their scatter holds the rounding already."""
    cells, readings = visits.condition, number_readings(visits.observations)
    pairs = len(cells) - len(np.unique(cells))
    return pairs > 0 and len(np.unique(np.stack([cells, readings]), axis=1).T) - len(np.unique(cells)) > HELD * pairs


def coordinate(one: Rounding, source: Source) -> float:
    """Rms of a coordinate of the tool by rounding, m."""
    lengths = 3 if source.observations.rotation is not None else source.tool_numbers
    return float(np.sqrt(np.mean(np.diagonal(one.covariance, axis1=1, axis2=2)[:, :lengths])))


def rounding_document(one: Rounding | None, source: Source) -> dict[str, Any]:
    """Step of each joint (deg, or mm of a prismatic one; 0: none), and the rms of a coordinate of the tool by rounding."""
    if one is None:
        return {"rounding_steps": None, "rounding_mm": None}
    slides = [joint.kind == "prismatic" for joint in source.model.robot.joints]
    steps = [s * (MM if slid else DEG) for s, slid in zip(one.steps.tolist(), slides, strict=True)]
    return {"rounding_steps": steps, "rounding_mm": mm(coordinate(one, source))}
