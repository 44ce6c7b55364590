"""Which noise the rows show before any name: that of repeats, of revisits, what the instrument states, or the fit's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.gap.noise.from_repeats import (
    Noise,
    fit_noise,
    repeat_noise,
    revisit_noise,
    sensors,
    stated_noise,
)
from kilter_core.gap.noise.pair_model import PairModel
from kilter_core.gap.noise.visits import Visits
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import Library
from kilter_core.gap.search.linear.linearized import ignore_step
from kilter_core.gap.search.rows.row_warnings import instrument_warnings, no_repeats_warning
from kilter_core.gap.search.sources.source import Source
from kilter_core.observations import Observations
from kilter_core.parameters import metres
from kilter_core.types import Floats, Ints

POSE = 6  # numbers of a pose; visits with more show markers
FEWEST_OF_REVISITS = (
    30  # numbers, from which they tell a noise within a factor of 1.3, and more than shots and the fit do
)
OF_WAYS = frozenset({"direction", "moments", "payload_kg"})  # what effects of sides and loads need


@dataclass
class NoiseReader:
    """Reads the noise of rows and their visits at the first fit of the geometry; what there is to say goes to ``warnings``."""

    source: Source
    values: Floats
    rows: Observations
    visits: Visits
    library: Library
    options: GapOptions
    warnings: list[dict[str, Any]]

    def read(self) -> Noise:
        """Noise of the tool, and of the sensors beside it."""
        source, visits = self.source, self.visits
        size = source.tool_numbers
        kinds, visit_residual = tuple(source.beside_numbers), source.residual(self.values)
        again = len(self.rows) > len(np.unique(visits.pose))
        residual = source.residual_of_rows(self.values, self.rows, ignore_step) if again else visit_residual
        noise = self._of_tool(residual[:, :size], visit_residual[:, :size])
        if not kinds:
            return noise
        condition = visits.condition[visits.visit] if again else None
        beside = sensors(residual[:, size:], condition, kinds, visits.count)
        return noise.with_independent_sensors(*beside, kinds)

    def _of_tool(self, residual: Floats, visit_residual: Floats) -> Noise:
        source, visits, options = self.source, self.visits, self.options
        size = visit_residual.shape[1]
        linear = source.unit == "rad" or visits.observations.rotation is not None
        found = self._noise_from_repeats(residual, visit_residual)
        if found is not None and source.unit != "rad":
            self.warnings += instrument_warnings(found, self._stated_sigma())
        if options.noise_mm is not None and not linear:
            return stated_noise(metres(options.noise_mm), visits, size)
        if found is not None:
            if not found.absolute:
                self.warnings.append(NO_RE_APPROACH)
                # Markers of one tool are all off by what the model lacks; how they shake against each other says nothing of it.
                return source.even(found) if size > POSE else found
            return found
        if visits.observations.sigma is not None and not linear:
            return stated_noise(visits.observations.sigma, visits, size)
        self.warnings.append(no_repeats_warning(visits))
        every = np.ones(len(visits), dtype=bool)
        return source.even(fit_noise(visit_residual, visits, every, source.geometry_freedom_share(visit_residual.size)))

    def _noise_from_repeats(self, residual: Floats, visit_residual: Floats) -> Noise | None:
        """Noise of repeats, else of revisits in other ways, else of shots within visits."""
        visits = self.visits
        points = visits.observations.position if visit_residual.shape[1] == 3 else None
        found = None
        if len(self.rows) > len(np.unique(visits.condition)):
            found = repeat_noise(residual, visit_residual, visits, points)
        if found is not None and found.absolute:
            return found
        pose = pose_beside_ways(visits)
        if len(visits) == len(np.unique(pose)):
            return found
        pairs = self._pairs(pose, points)
        noise = None if pairs is None else revisit_noise(residual, visit_residual, visits, points, pairs)
        few = noise is None or (found is not None and noise.freedom < FEWEST_OF_REVISITS)
        return found if few else noise

    def _pairs(self, pose: Ints, points: Floats | None) -> PairModel | None:
        """The library's effects of sides and loads as what revisits may differ by; None where it has none."""
        candidates: list[tuple[int, ...]] = []
        for one in self.library.candidates:
            needs = frozenset().union(*(effect.needs for effect in one.effects))
            if needs & OF_WAYS and needs <= OF_WAYS:
                candidates.append(one.columns)
        if not candidates:
            return None
        columns = np.unique(np.array([k for own in candidates for k in own], dtype=np.int64))
        size = self.source.tool_numbers
        W = self.source.without_geometry().linear(self.values, only=columns.tolist()).W[:, :size]
        own = tuple(tuple(np.searchsorted(columns, c).tolist()) for c in candidates)
        lengths = 3 if size == POSE else None
        return PairModel(pose, W, columns, own, self.visits, points, lengths, not self.options.effects)

    def _stated_sigma(self) -> float | None:
        """Standard deviation m of a coordinate of a row, as the instrument states it: the columns of rows, else the option."""
        sigma = self.visits.observations.sigma
        if sigma is None:
            return None if self.options.noise_mm is None else metres(self.options.noise_mm)
        return float(np.sqrt(np.nanmean(sigma**2 * self.visits.count[:, None])))


def pose_beside_ways(visits: Visits) -> Ints:
    """Number (V,) what revisits share beside side and load: pose, session, set-up and contact."""
    rows = visits.observations
    plain = replace(rows, direction=None, payload_kg=None, payload_com=None, link_mass=None, link_wrench=None)
    return plain.conditions()


NO_RE_APPROACH = {
    "code": "no_re_approach",
    "message": "Repeats were taken without leaving the pose, so how well the arm comes back is not known: unless what is left "
    "is as small as these repeats, every verdict is relative to the scatter of the fit. Approach ten poses anew three times "
    "each, with another pose in between.",
}
