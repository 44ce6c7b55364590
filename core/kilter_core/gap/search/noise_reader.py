"""What the rows say before any name: their noise, copies among repeats, repeats that drifted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.effects.physical import joint_numbers
from kilter_core.errors import FindingDocument
from kilter_core.gap.noise.covariance_models import PairModel
from kilter_core.gap.noise.from_repeats import (
    Noise,
    fit_noise,
    repeat_noise,
    revisit_noise,
    sensors,
    stated_noise,
)
from kilter_core.gap.noise.visits import Visits
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import Library
from kilter_core.gap.search.linear.linearized import LinearizedProblem, ignore_step
from kilter_core.gap.search.sources.source import Rounding, Source, coordinate
from kilter_core.observations import Observations
from kilter_core.parameters import DEG, degrees, metres, mm
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
    warnings: list[FindingDocument]

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


NO_RE_APPROACH = FindingDocument.make(
    "no_re_approach",
    "Repeats were taken without leaving the pose, so how well the arm comes back is not known: unless what is left "
    "is as small as these repeats, every verdict is relative to the scatter of the fit. Approach ten poses anew three times "
    "each, with another pose in between.",
)


# By the model with what it knows at the end.
JUDGED_AGAIN = ("outliers", "repeats_drift", "drift_not_separated", "revisits_bound_noise")
BEYOND = 3.0  # times the instrument, from which repeats show that something moves
FEWEST_AGAIN = 3  # poses visited again from which a person meant to repeat


REPEATS_SET_ASIDE: FindingDocument = FindingDocument.make(
    "no_repeats",
    "Without the visits that were set aside fewer than three repeated approaches are left, so the noise is that of "
    "the fit: every verdict is relative to it. Repeat ten poses thrice, coming from the same pose before.",
)


def no_repeats_warning(visits: Visits) -> FindingDocument:
    """Say that no visits should agree, and why: no pose was visited again, or every time in another session."""
    again = np.flatnonzero(np.bincount(visits.pose) > 1)
    session = visits.observations.session
    apart = session is not None and any(np.ptp(session[visits.pose == k]) for k in again)
    relative = (
        "so the noise is that of the fit: every verdict is relative to it, and above provisional is only what both "
    )
    relative += "halves, or a confirmation, show alike."
    if len(again) < FEWEST_AGAIN or not apart:
        said = f"No pose was repeated often enough, {relative} Repeat ten poses thrice, others between."
    else:
        said = (
            f"{len(again)} poses were visited again, but in another session, and too few visits are alike to show the noise; "
            f"{relative} Come back to ten poses thrice within a session."
        )
    return FindingDocument.make("no_repeats", said)


def rounding_warnings(one: Rounding | None, source: Source, held: bool) -> Iterator[FindingDocument]:
    """Say to which step joint readings are rounded, how far that moves the tool, and how it counts."""
    if one is None:
        return
    joints = source.model.robot.joints
    said = []
    for step in dict.fromkeys(s for s in one.steps.tolist() if s > 0.0):
        own = [j for j, s in enumerate(one.steps) if s == step]
        slides = joints[own[0]].kind == "prismatic"
        size = f"{mm(step):.4g} mm" if slides else f"{degrees(step):.4g} deg"
        said.append(f"{size} ({joint_numbers(own)})")
    counted = "which the noise holds already" if held else "which counts as noise of its own"
    yield FindingDocument.make(
        "rounded_readings",
        f"The joint readings are multiples of {' and '.join(said)}: rounding moves the tool by "
        f"{mm(coordinate(one, source)):.2g} mm, rms of a coordinate, {counted}. Record the readings with more digits.",
    )


def noise_warnings(noise: Noise, joint: bool) -> Iterator[FindingDocument]:
    """Say how far repeats drifted, or that the rows cannot show it."""
    drift = noise.drift
    unit, scale = ("deg", DEG) if joint else ("µm", 1e6)
    if drift is not None and drift.is_significant:
        sizes = {"over the campaign": drift.over_campaign * scale, "per K": drift.per_kelvin * scale}
        said = " and ".join(f"{v:.3g} {unit} {k}" for k, v in sizes.items() if v > 0.0) or f"0 {unit}"
        clock = "" if drift.timed else " (by the order of the rows, because there is no clock)"
        yield FindingDocument.make(
            "repeats_drift",
            f"The repeats drifted by {said}{clock}, rms of a coordinate. The noise is what is left of them at no "
            "distance in time and temperature. Let arm and instrument warm up, and repeat poses soon after one another.",
        )
    if noise.has_too_few_revisits:
        yield FindingDocument.make(
            "revisits_bound_noise",
            "The noise is that of poses visited again from other sides or under other loads, and what these do "
            "could not all be fitted: noise is this at most, and no claim is confirmed by it. Come back to ten poses thrice "
            "in the same way.",
        )
    elif noise.most:
        yield FindingDocument.make(
            "drift_not_separated",
            "The repeats are too few, or all far apart in time, so noise and drift cannot be separated: noise is "
            "this at most, and no claim is confirmed by it. Repeat ten poses with only one other pose in between.",
        )


def instrument_warnings(noise: Noise, stated: float | None) -> Iterator[FindingDocument]:
    """Say that repeats scatter by far more than the instrument, ``stated`` m of a coordinate, does."""
    if stated is None or not stated > 0.0 or noise.between is None or noise.coordinate < BEYOND * stated:
        return
    ratio = noise.coordinate / stated
    within = "" if noise.within is None else f" ({mm(noise.within):.3g} mm without leaving the pose)"
    yield FindingDocument.make(
        "noise_beyond_instrument",
        f"Repeats differ by {mm(noise.coordinate):.3g} mm (standard deviation of a coordinate){within}, "
        f"{ratio:.2g} times what the instrument states ({mm(stated):.3g} mm): something moves between visits. Hysteresis "
        "and friction memory of the joints (presliding), a loose mount or nest, or warming do that; errors smaller than this "
        "cannot be seen. Approach poses from the same side and on the same way, and check mounts.",
        ratio=ratio,
    )


def outlier_warnings(problem: LinearizedProblem) -> Iterator[FindingDocument]:
    """Say how many visits were set aside."""
    used = problem.settings.used
    if not used.all():
        yield FindingDocument.make(
            "outliers",
            f"{int(np.sum(~used))} of {len(used)} visits could be explained by nothing in the library and were set "
            "aside.",
            visits=int(np.sum(~used)),
        )
