"""An identification from start to report: registration only, the fit, the held-out truth about both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.other_campaigns import placed_later
from kilter_core.errors import OptionError
from kilter_core.identify.carried_masses import beside_masses, considered_masses, describe_masses
from kilter_core.identify.comparison.model_comparison import PoseErrors, geometry_alone
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fit.row_errors import RowErrors
from kilter_core.identify.fit.tukey import set_aside
from kilter_core.identify.fleet.asked import of_its_type
from kilter_core.identify.fleet.prior import FleetPrior
from kilter_core.identify.fleet.said import prior_document, prior_warnings
from kilter_core.identify.fleet.versions import FleetVersion
from kilter_core.identify.folds import continues, cross_validated, in_fitted_frames
from kilter_core.identify.gauges import gauges
from kilter_core.identify.holdout import Folds, split
from kilter_core.identify.identifiable.identifiability import NullDirection, null_directions
from kilter_core.identify.identifiable.load_model import far_from_stated, load_rows
from kilter_core.identify.identifiable.observability import correlated_groups, observability
from kilter_core.identify.learned import Learned, select_learned_effects
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.another_arm import another_arm
from kilter_core.identify.plausibility.astray_rows import of_held_out, unless_astray
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.identify.plausibility.views.flat_boards import bent_boards
from kilter_core.identify.reference import frame_sources, refuse_contradicted, wanted_frames
from kilter_core.identify.registry import METHODS
from kilter_core.identify.report import fit_warnings, known_of_fit, null_rows, parameter_rows
from kilter_core.identify.rows.errors_by_kind import KindErrors, Shares, squared_errors_by_kind
from kilter_core.identify.rows.influence import parameter_influence
from kilter_core.identify.rows.measurement_of_rows import between_rows, measurement_for
from kilter_core.identify.rows.noise import Repeats
from kilter_core.identify.rows.read_tilt import as_inputs
from kilter_core.identify.scale_gauge import with_likeliest_scale
from kilter_core.identify.setup_frames import Frames, OwnFrame, held_out, marginal, of_the_arm, without_frames
from kilter_core.identify.start_model import build_start_model, refuse_missing_columns
from kilter_core.identify.uncertainty.by_views import tool_sigma_from_views
from kilter_core.identify.uncertainty.considered import beside_drawn_masses
from kilter_core.identify.uncertainty.held_arm import beside_held_arm
from kilter_core.identify.uncertainty.intervals import Intervals, bootstrap, profile
from kilter_core.identify.uncertainty.predictive import Predictive, predictive, residual_sigma
from kilter_core.identify.uncertainty.stated_noise import BeyondNoise
from kilter_core.identify.uncertainty.structure import Structure
from kilter_core.identify.view_report import (
    held_views,
    predictive_from_views_only,
    tell_less,
    too_large_to_deploy,
    views_document,
    with_control,
    with_own_scatter,
    with_validation_views,
    wrong,
)
from kilter_core.identify.views.cameras import with_cameras
from kilter_core.identify.views.timing import bad_timing
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.view_scatter import ToolErrors
from kilter_core.measurement.metrics import Errors, metrics_document
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.shared_rows import refuse_shared_rows
from kilter_core.parameters import degrees, mm
from kilter_core.types import Each, Floats, Ints, Progress, run_sequentially, unheard

Validation = Observations | float | Folds | None
HeldOut = tuple[dict[str, Errors], PoseErrors | None, RowErrors | None, KindErrors]
NOTHING_HELD: HeldOut = ({}, None, None, {})
INFLUENCE_ROWS = 500


@dataclass(frozen=True)
class Identification:
    """Result of :func:`identify`; ``metrics`` as in the contract, ``covariance (F, F)`` SI."""

    calibration: Calibration
    fit: Fit
    metrics: dict[str, Any]
    noise_m: float
    noise_source: str
    repeats: Repeats
    predictive: Predictive
    null_directions: tuple[NullDirection, ...]
    warnings: tuple[dict[str, Any], ...]
    method: str = "least_squares"
    influence: list[dict[str, Any]] | None = None
    intervals: Intervals | None = None
    learned: Learned | None = None
    masses: dict[str, Any] | None = None  # how they were taken, where an effect follows the load
    own_frames: tuple[OwnFrame, ...] = ()
    inside: Ints | None = None  # rows of those given that were fitted, all when None
    fitted_rows: RowErrors | None = None
    shares: Shares | None = None  # what each kind of measurement says
    fitted_kinds: KindErrors = field(default_factory=dict)
    held_kinds: KindErrors = field(default_factory=dict)
    beyond: BeyondNoise | None = None  # more than the stated noise is left
    views: dict[str, Any] = field(default_factory=dict)  # cameras and boards, and what their views say of the tool
    fleet: FleetPrior | None = None  # what was known of the type, whether it was believed or not
    held_rows: RowErrors | None = None  # of the validation when that is rows of its own, else of those given

    @property
    def scale(self) -> tuple[float, float]:
        """Standard deviations (m, rad) of points and rotations by which residuals were weighted."""
        return float(np.mean(self.fit.problem.weights.points)), float(np.mean(self.fit.problem.weights.turns))

    @property
    def set_aside(self) -> list[dict[str, Any]]:
        """Rows of those given, counted from 0, that count less than half in the fit."""
        found = set_aside(self.fit)
        return found if self.inside is None else [{**one, "row": int(self.inside[one["row"]])} for one in found]

    @property
    def load_model(self) -> list[dict[str, Any]]:
        """Masses and centres as stated and as found, where load errors were carried."""
        return load_rows(self.calibration, self.fit.names, self.fit.sigma, self.fit.problem.prior_sigma)

    @property
    def covariance(self) -> Floats:
        """Posterior covariance of the free parameters, SI."""
        return self.fit.covariance

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the covariance."""
        return self.fit.names

    def to_document(self) -> dict[str, Any]:
        """The identify result of the contract: mm, degrees, names, units."""
        by_views = "pixels" in self.views  # their noise is in px: the length that weighs them means nothing
        return {
            "parameters": parameter_rows(self.calibration, self.fit, self.intervals),
            "scale": {"point_mm": mm(self.scale[0]), "turn_deg": float(degrees(self.scale[1]))},
            "set_aside": self.set_aside,
            "null_directions": null_rows(self.null_directions, known_of_fit(self.calibration, self.fit)),
            "metrics": self.metrics,
            "noise_mm": None if by_views else mm(self.noise_m),
            "noise_source": None if by_views else self.noise_source,
            "noise": {
                "residuals_mm": None if by_views else mm(residual_sigma(self.fit)),
                "inadequacy_mm": mm(self.predictive.inadequacy),
                **self.repeats.to_document(),
            },
            "warnings": list(self.warnings),
            "iterations": self.fit.iterations,
            "method": {"name": self.method, **self.fit.report},
            "influence": self.influence,
            "intervals": None if self.intervals is None else self.intervals.kind,
            "learned": None if self.learned is None else self.learned.to_document(),
            "load_model": self.load_model,
            "masses": self.masses,
            **_together(self.fit),
            **({} if self.shares is None else self.shares.to_document(self.fitted_kinds, self.held_kinds)),
            **{
                f"{which}_refitted": [frame.to_document() for frame in self.own_frames if frame.which == which]
                for which in ("base", "tool")
            },
            "reference": frame_sources(self.calibration),
            "prior": None if self.fleet is None else prior_document(self.fleet, self.fit),
            **self.views,
        }


def identify(
    robot: Robot,
    train: Observations,
    validation: Validation = None,
    options: IdentifyOptions | None = None,
    start: Calibration | None = None,
    progress: Progress | None = None,
    prior: Prior | None = None,
    each: Each = run_sequentially,
    fleet: Sequence[FleetVersion] | None = None,
) -> Identification:
    """Identify a robot from observations.

    ``validation`` is other observations, a fraction of the poses (of contacts the placements) to hold out, folds, or None.
    With folds each of them is predicted once by a model that never saw it, and the final fit uses all.
    ``start`` continues from a version; ``prior`` is its covariance, which ``kalman`` continues from.
    ``each`` computes the folds and the profiles of intervals; another may do so in several processes.
    ``fleet`` are versions of other robots of the type, one of each, whose mean and spread are a prior (option ``prior``).

    Raises:
        CoreError: ``fleet_too_few``, ``fleet_gauge``, ``fleet_conflict``: no prior from these versions.
        TooFewPosesError: not enough distinct poses. OptionError: options that do not fit the robot or the data.
        ObservationError: nothing measured, ``foreign_observations``, ``rows_shared``. NotConvergedError: no minimum found.

    """
    options, progress = options or IdentifyOptions(), progress or unheard
    train, validation = as_inputs(options.make_effects(), start, train, validation)
    begin, nominal = build_start_model(robot, train, options, start), Calibration.nominal(robot)
    odd = _belonging(begin, train, validation)
    begin, train, validation, frames = _in_one_frame(begin, train, validation, options)
    begin, of_type = of_its_type(begin, train, options, fleet)
    progress(0.02, "splitting by pose")
    (held, compared, by_row, kinds), views = NOTHING_HELD, None
    if isinstance(validation, Folds):
        given = (nominal, begin, train, validation.folds, options, progress, prior, each)
        held, compared, by_row, kinds, views = cross_validated(*given)
    train, validation, options, (inside, outside) = _split_rows(train, validation, options, begin)
    begin, measurement = _model_and_measurement(begin, train, options)
    found, wanted = _register_frames(begin, measurement.of_tool(), options, prior)
    begin, learned = select_learned_effects(begin, train, options, prior)
    made = fit_by_method(begin, measurement, options, _section(progress, 0.5, 0.4), prior)
    fit = beside_held_arm(with_likeliest_scale(made))
    calibration = fit.calibration(*wanted)
    stages = _stages(found if measurement.tool.places_itself else nominal, found, calibration)
    own = [] if frames is None else frames.fitted_frames(calibration)
    if isinstance(validation, Observations):
        apart = (stages, geometry_alone(begin, measurement, options), frames, validation, options, measurement)
        held, compared, by_row, kinds, own[len(own) :] = held_out(*apart)
        by_row, views = by_row.with_row_numbers(outside), held_views(calibration, validation, measurement)
    progress(0.95, "identifiability")
    errors = {name: Errors.from_calibration(stage, measurement) for name, stage in stages.items()}
    refuse_contradicted(options, begin, found, errors["identified"].mean, errors["registration_only"].mean)
    told, last = metrics_document(errors, held), _section(progress, 0.95, 0.04)
    result = _assemble_identification(without_frames(calibration), fit, train, told, options, last, each, learned)
    said = (*result.warnings, *wrong(fit, begin, options, inside, result.beyond), *odd, *_worse(compared, of_type, fit))
    fitted = RowErrors.from_stages(stages, measurement, np.arange(len(train))).with_row_numbers(inside)
    return replace(
        result,
        own_frames=tuple(own),
        inside=inside,
        fitted_rows=fitted,
        held_rows=by_row,
        held_kinds=kinds,
        fleet=of_type,
        fitted_kinds=squared_errors_by_kind(stages, measurement),
        **_views(result, said, views, measurement, held, begin),
    )


def _model_and_measurement(
    begin: Calibration, train: Observations, options: IdentifyOptions
) -> tuple[Calibration, Measurement]:
    """The model to fit with its cameras, and what was measured."""
    measurement = measurement_for(train, options, begin.marker_points)
    return with_cameras(begin, train, measurement), measurement


def _register_frames(
    begin: Calibration, of_tool: Measurement, options: IdentifyOptions, prior: Prior | None
) -> tuple[Calibration, tuple[Floats, Floats]]:
    """The nominal robot in fitted frames, and the base and tool frames that a correction should work in."""
    found = in_fitted_frames(begin, of_tool, options, prior)
    return found, wanted_frames(begin, found, of_tool, options, continues(options, prior))


def _worse(compared: PoseErrors | None, of_type: FleetPrior | None, fit: Fit) -> Iterator[dict[str, Any]]:
    """Warnings of what a fit was compared with: simpler models, and other arms of the type."""
    yield from () if compared is None else compared.warnings()
    yield from () if of_type is None else prior_warnings(of_type, fit)


def _stages(nominal: Calibration, found: Calibration, identified: Calibration) -> dict[str, Calibration]:
    return {"nominal": nominal, "registration_only": found, "identified": identified}


def _views(
    result: Identification,
    warnings: tuple[dict[str, Any], ...],
    unfitted: ToolErrors | None,
    measurement: Measurement,
    held: dict[str, Errors],
    begin: Calibration,
) -> dict[str, Any]:
    """What views say, of those held out and of shuffled joints too, and the warnings with theirs."""
    views = with_validation_views(with_control(result.views, begin, measurement.observations), unfitted)
    shown = {name: errors.to_document()["rms_mm"] for name, errors in held.items()}
    said = *too_large_to_deploy(views, shown.get("registration_only")), *tell_less(views, shown.get("identified"))
    return {"views": views, "warnings": (*unless_astray(warnings), *said)}


def _in_one_frame(
    begin: Calibration, train: Observations, validation: Validation, options: IdentifyOptions
) -> tuple[Calibration, Observations, Validation, Frames | None]:
    """The model with the frames of later set-ups, and rows given in the frame of the first."""
    refuse_missing_columns(begin, train)
    frames = Frames.from_observations(begin, train, options)
    if frames is None:
        return begin, train, validation, None
    seen = frames.laid(validation) if isinstance(validation, Observations) else validation
    return frames.in_model(begin), frames.laid(train), seen, frames


def _belonging(begin: Calibration, train: Observations, validation: Validation) -> tuple[dict[str, Any], ...]:
    """Refuse rows that cannot be of this robot or are held out and fitted at once; what is odd about those to fit."""
    refuse_missing_columns(begin, train)
    remarks = refuse_mixed_up(begin, train)
    if isinstance(validation, Observations):
        refuse_shared_rows(train, validation, "validation")
        remarks = (*remarks, *of_held_out(refuse_mixed_up(begin, validation)))
    return remarks


def _section(progress: Progress, start: float, share: float) -> Progress:
    return lambda fraction, stage: progress(start + share * fraction, stage)


def _split_rows(
    train: Observations, validation: Validation, options: IdentifyOptions, begin: Calibration
) -> tuple[Observations, Validation, IdentifyOptions, tuple[Ints | None, Ints | None]]:
    """Rows to fit and to hold out, the options for them, and which of the rows given they are of a fraction."""
    if not isinstance(validation, Observations | float | Folds | None):
        raise OptionError(
            f"validation is {type(validation).__name__}: give observations, a fraction of the poses, Folds, or None.",
            option="validation",
        )
    if isinstance(validation, Observations):
        return train, placed_later(validation), options, (None, None)
    if not isinstance(validation, float):
        return train, validation, options, (None, None)
    measurement_for(train, options, begin.marker_points)  # what is wrong with all rows is said of all of them
    inside, outside = split(train, validation, options.seed)
    fitted = train.select(inside)
    return fitted, train.select(outside), between_rows(options, fitted), (inside, outside)


def _assemble_identification(
    calibration: Calibration,
    fit: Fit,
    train: Observations,
    metrics: dict[str, Any],
    options: IdentifyOptions,
    progress: Progress,
    each: Each,
    learned: Learned | None = None,
) -> Identification:
    """What was found, with all that is said about it."""
    repeats = Repeats.from_observations(train, fit.residual)
    sigma = repeats.between
    shares = Shares.from_fit(fit, marginal(fit).names)
    plain, (fit, scatter) = fit, with_own_scatter(fit)
    views = views_document(calibration, fit, scatter)
    beyond = BeyondNoise.from_fit(fit, repeats, options.noise_m)
    masses = considered_masses(calibration.model.effects, calibration.robot, train, options)
    fit = predicted = fit if beyond is None else beyond.widen(fit)
    if masses is not None:
        fit = beside_drawn_masses(plain, fit, masses)
    wider = (1.0 if beyond is None else beyond.widening) * fit.sigma / predicted.sigma
    intervals = _intervals(plain, fit, options, progress, each, wider)
    fit_of_all, fit = fit, marginal(fit)
    return Identification(
        calibration=calibration,
        fit=fit,
        metrics=metrics,
        noise_m=float(np.mean(fit.problem.weights.points)) if sigma is None else sigma,
        noise_source="residuals of the fit" if sigma is None else "repeats",
        repeats=repeats,
        predictive=predictive_from_views_only(fit_of_all, scatter)
        or predictive(
            marginal(predicted), repeats, options.noise_m, Structure.from_fit(plain), tool_sigma_from_views(plain)
        ),
        null_directions=null_directions(*beside_masses(fit)),
        masses=describe_masses(calibration.robot, calibration.model.effects, options, masses),
        warnings=(
            *fit_warnings(fit, train, repeats),
            *(() if learned is None else (learned.warning(),)),
            *another_arm(calibration),
            *gauges(fit_of_all),
            *bent_boards(fit_of_all),
            *bad_timing(fit_of_all),
            *far_from_stated(load_rows(calibration, fit.names, fit.sigma, fit.problem.prior_sigma)),
        ),
        method=options.method,
        influence=parameter_influence(calibration, _influence_rows(train, options), fit.names).to_document()
        if fit.names
        else [],
        intervals=intervals,
        learned=learned,
        shares=shares,
        beyond=beyond,
        views=views,
    )


def _influence_rows(train: Observations, options: IdentifyOptions) -> Observations:
    """Rows to say the influence at: all where the method weighs by it, else so many that it costs little beside the fit."""
    if METHODS[options.method].weighs_by_influence or len(train) <= INFLUENCE_ROWS:
        return train
    return train.select(np.unique(np.linspace(0, len(train) - 1, INFLUENCE_ROWS).astype(int)))


def _intervals(
    plain: Fit, fit: Fit, options: IdentifyOptions, progress: Progress, each: Each, wider: Floats
) -> Intervals | None:
    """Intervals of a fit; a profile, whose likelihood takes rows as independent, is widened to what the poses show."""
    if options.intervals is None:
        return None
    if options.intervals == "profile":
        found = profile(plain, progress, each).widen_by_factor(fit.sigma / plain.sigma)
    else:
        found = bootstrap(plain, options.seed, progress).widen_by_factor(wider)
    arm = of_the_arm(fit)
    return replace(found, lower=found.lower[arm], upper=found.upper[arm], stands_in=found.stands_in[arm])


def _together(fit: Fit) -> dict[str, Any]:
    """Observability of the poses, per prior sigma and in mm, and the parameters that go together."""
    millimetre = mm(float(np.mean(fit.problem.weights.points)))
    poses = int(fit.problem.measurement.observations.pose_groups().max()) + 1
    groups = correlated_groups(fit.covariance, fit.names)
    J, _, prior_sigma = beside_masses(fit)
    return {
        "observability": observability(J * prior_sigma * millimetre, poses).to_document(),
        "correlated_groups": [{"parameters": list(g.names), "correlation": g.strongest} for g in groups],
    }
