"""What a search leaves to be stored: the fit as a calibration, the frames a correction works in, its uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import f

from kilter_core.effects import Effect
from kilter_core.effects.curves import JointCurve
from kilter_core.effects.laws import LawOfTemperature
from kilter_core.effects.physical import JOINT_CURVE
from kilter_core.errors import FindingDocument
from kilter_core.gap.evidence.fits.final_fit import Posterior, posterior
from kilter_core.gap.evidence.fits.intervals import scale_freedom
from kilter_core.gap.evidence.verdict import Judged
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import refit
from kilter_core.gap.search.prepare import with_masses
from kilter_core.gap.study import SHIFT
from kilter_core.identify.comparison import geometry_alone
from kilter_core.identify.fleet_report import prior_dominated_mask
from kilter_core.identify.identifiability import identifiable, load_rows, null_directions
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.reference import frame_sources, register_nominal, wanted_frames
from kilter_core.identify.report import (
    build_parameter_rows,
    estimate_workspace_spread,
    known_parameters,
    null_rows,
    unobservable_names,
)
from kilter_core.identify.uncertainty.predictive import CHANCE, EXACT, Predictive
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts as held_rows
from kilter_core.measurement.frames import Errors, metrics_document
from kilter_core.measurement.kind import POINTS
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.calibration import Doubt
from kilter_core.observations import Observations
from kilter_core.parameters import indices
from kilter_core.types import Ints

# What the last fit leaves of a coordinate of the tool: its noise, and what it leaves beyond that, corrected for its
# freedom.
#
# A version read both from the errors on the rows that were searched, which are smaller by what the parameters took
# of them: its 95 % intervals held 92 % of new coordinates where the noise was that of the fit.


def left_over(found: SearchResult, known: Posterior) -> Predictive | None:
    """What a version knows of itself; None where its rows are not single points or poses of the tool by an instrument."""
    settings = found.problem.settings
    source = settings.source
    rows = source.observations
    points = rows.position is not None and rows.markers is None and rows.pose_weight is None
    if not (points and source.observes_tool and source.observes_places) or settings.inflation > 1.0:
        return None
    left = found.problem.gram.condition_on_columns(found.columns)
    nu, ratio = max(left.nu, 1.0), left.yy / max(left.nu, 1.0)
    size = float(np.sqrt(np.mean(np.diag(settings.of_row)[:3])))
    scale = scale_freedom(found)
    if not settings.trusted:
        return Predictive(known.names, known.covariance, size * float(np.sqrt(ratio)), 0.0, scale, POINTS)
    known_by = min(max(scale, 1.0), float(EXACT))
    if ratio > f.isf(CHANCE, nu, known_by):
        return Predictive(known.names, known.covariance, size * float(np.sqrt(ratio - 1.0)), size, scale, POINTS)
    if np.isfinite(scale) and ratio > f.ppf(CHANCE, nu, known_by):
        # A dozen repeats know the noise to a fifth, and hundreds of rows that a model agrees with to some per cent.
        size *= float(np.sqrt((known_by + nu * ratio) / (known_by + nu)))
        scale += nu
    return Predictive(known.names, known.covariance, 0.0, size, scale, POINTS)


@dataclass(frozen=True)
class Stored:
    """A version made by a search. ``registered`` is the nominal robot in fitted frames, None where no tool was measured.

    ``shown`` are the rows that were searched and ``held`` those held out, views as poses of the tool. ``geometry`` is the
    geometry fitted to the former without effects; None where nothing is held out to compare it on, or no effect was found.
    ``left`` is what the fit leaves of a coordinate; None where only the errors on the rows say it.
    """

    calibration: Calibration
    posterior: Posterior
    shown: Observations
    registered: Calibration | None = None
    held: Observations | None = None
    geometry: Calibration | None = None
    left: Predictive | None = None

    def with_doubts(self, doubts: tuple[Doubt, ...]) -> Stored:
        """The version that says where it is less sure than its parameters say."""
        return replace(self, calibration=replace(self.calibration, doubts=doubts))

    def parameters(self) -> list[dict[str, Any]]:
        """Rows of the free parameters, as an identification has them."""
        found, model = self.posterior, self.calibration.model
        known = identifiable(found.sigma, found.prior_sigma)
        known &= ~np.isin(found.names, list(unobservable_names(model, self.shown)))
        rows = build_parameter_rows(self.calibration, found.names, found.sigma, known)
        if model.of_type is None:
            return rows
        rests = prior_dominated_mask(model.of_type, found.names, found.sigma, found.prior_sigma)
        return [{**row, "from_prior": bool(one)} for row, one in zip(rows, rests, strict=True)]

    def without_correction(self, of: Collection[str]) -> Stored:
        """The same version whose laws of temperature ``of`` these ids predict the rows but are not made up for."""
        model = self.calibration.model
        effects = tuple(
            replace(e, corrected=False) if isinstance(e, LawOfTemperature) and e.id in of else e for e in model.effects
        )
        return replace(self, calibration=replace(self.calibration, model=replace(model, effects=effects)))

    def load_model(self) -> list[dict[str, Any]]:
        """Masses and centres as stated and as found, where an effect that follows the load shows them."""
        found = self.posterior
        return load_rows(self.calibration, found.names, found.sigma, found.prior_sigma)

    def null_directions(self) -> list[dict[str, Any]]:
        """What the poses cannot distinguish, as an identification says it."""
        found = self.posterior
        if found.J is None:
            return []
        known = known_parameters(self.calibration, found.names, found.covariance, found.prior_sigma)
        return null_rows(null_directions(found.J, found.names, found.prior_sigma), known)

    def similar_pose_warnings(self) -> Iterator[FindingDocument]:
        """Warn of poses too alike to know the tool elsewhere, as an identification does."""
        if self.registered is None or (self.shown.position is None and self.shown.markers is None):
            return
        model = self.calibration.model
        free = indices(model.names, self.posterior.names)
        spread = estimate_workspace_spread(
            model, free, self.posterior.covariance, self.calibration.values, self.shown.q
        )
        if spread is not None and spread.too_alike:
            yield spread.warning()

    def covariance(self) -> dict[str, Any]:
        """Covariance document of a version."""
        if self.left is not None:
            return self.left.to_document()
        return {
            "names": list(self.posterior.names),
            "matrix": self.posterior.covariance.tolist(),
            "units": "SI",
        }

    def metrics(self, train: Observations, held: Observations | None, spikes: Ints) -> dict[str, Any]:
        """Metrics of an identification on these rows; none for joint data, for the tool was not measured.

        Rows ``spikes (K,)`` of those held out are left out, as the search leaves them out of its own errors. Of rows with
        pixels alone the poses count that the search took them as: the version has no cameras to see them by.
        """
        if self.registered is None:
            return {}
        if train.pixels is not None and train.position is None and train.markers is None:
            train, held = self.shown, self.held
        stages = {
            "nominal": Calibration.nominal(self.calibration.robot),
            "registration_only": self.registered,
            "identified": self.calibration,
        }

        compared = stages if self.geometry is None else {**stages, "geometry_fitted": self.geometry}

        def errors(
            rows: Observations | None, of: Mapping[str, Calibration], anchor: Measurement | None = None
        ) -> dict[str, Errors]:
            if rows is None or (rows.position is None and rows.markers is None and not held_rows(rows)):
                return {}
            measurement = Measurement.from_observations(rows, self.calibration.marker_points, held=True, anchor=anchor)
            return {name: Errors.from_calibration(stage, measurement) for name, stage in of.items()}

        if held is not None and len(spikes):
            held = held.select(np.setdiff1d(np.arange(len(held)), spikes))
        return metrics_document(errors(train, stages), errors(held, compared, _anchor(train)), len(spikes))

    def reference(self) -> dict[str, str]:
        """Where the frames a correction works in come from."""
        return frame_sources(self.calibration)


def _anchor(train: Observations) -> Measurement | None:
    """The rows that say where contacts stand, for held-out rows of the same ones; None of other rows."""
    return Measurement(train) if held_rows(train) else None


def build_stored_version(
    found: SearchResult, begin: Calibration, rows: Observations, options: GapOptions, held: Observations | None = None
) -> Stored:
    """What is stored of a search that started at ``begin``; the effects' configuration comes from ``rows``."""
    settings = found.problem.settings
    source = settings.source
    model = _model(found, begin, rows)
    calibration = source.to_calibration(found.problem.values, model, begin)
    wide = posterior(found, begin, calibration)
    shown = source.tool_measured(settings.used)
    if shown is None:
        return Stored(calibration, wide, source.observations)
    nominal = register_nominal(begin, shown)
    asked = IdentifyOptions(
        base=options.base,
        tool=options.tool,
        reference=options.reference,
        free=options.free,
        fix=options.fix,
        loss="huber",
    )
    base, tool = wanted_frames(begin, nominal, shown, asked)
    calibration = replace(calibration, wanted_base=base, wanted_tool=tool)
    geometry = None if held is None else geometry_alone(calibration, shown, asked, (SHIFT,))
    return Stored(calibration, wide, shown.observations, nominal, held, geometry, left_over(found, wide))


def settled_search(found: SearchResult, effects: Sequence[Judged]) -> SearchResult:
    """The search fitted again without the named effects that a version is not to hold; itself where it is to hold all."""
    out = {j.evidence.place for j in effects if not j.storable}
    if not out:
        return found
    return refit_chosen(found, tuple(k for k in found.chosen if k not in out))


def refit_chosen(found: SearchResult, chosen: tuple[int, ...]) -> SearchResult:
    """The search fitted again with some of the named effects."""
    problem = found.problem
    return replace(
        found, chosen=chosen, problem=refit(problem.settings, problem.values, found.selector.columns(chosen))
    )


def _model(found: SearchResult, begin: Calibration, rows: Observations) -> RobotModel:
    """The robot with the effects of the start and those named, in the frames of the fit."""
    source = found.problem.settings.source
    candidates = [found.selector.scorer.candidates[k] for k in found.chosen]
    q = source.observations.q
    named = (
        e.with_measured_range(q)
        if isinstance(e, JointCurve) and e.physical_class(begin.robot).id == JOINT_CURVE.id
        else e
        for e in _merge_effects(candidates, begin, rows)
    )
    effects = with_masses((*begin.model.effects, *named), source)
    frames = source.frames(begin)
    return replace(frames, effects=effects, load_chain=frames.load_chain if effects else None)


def _merge_effects(chosen: list[Candidate], begin: Calibration, rows: Observations) -> tuple[Effect, ...]:
    """Effects of the chosen candidates, one per effect where one configuration can hold them all."""
    robot = begin.robot
    out: list[Effect] = []
    for effect_id in dict.fromkeys(c.id for c in chosen):
        parts = [e for c in chosen if c.id == effect_id for e in c.effects]
        wanted = {p.name for e in parts for p in e.parameters(robot)}
        kind = type(parts[0])
        if kind.at_joints and "drivers" not in kind.counted and "partner" not in kind.counted:
            joints = tuple(sorted({j for e in parts for j in e.joints or ()}))
            whole = kind(joints=joints).configure_for_robot(robot, rows)
            # What a configuration took from the rows, as a range or the first time, must be that of the search.
            alike = all(kind(joints=e.joints).configure_for_robot(robot, rows) == e for e in parts)
            if alike and {p.name for p in whole.parameters(robot)} == wanted:
                out.append(whole)
                continue
        out += list(dict.fromkeys(parts))
    return tuple(out)
