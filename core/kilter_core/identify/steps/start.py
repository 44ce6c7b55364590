"""What an identification begins with, and the fit of a study."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from kilter_core.arm.robot import Robot
from kilter_core.effects.laws import placed_later
from kilter_core.errors import FindingDocument, ObservationError, OptionError
from kilter_core.identify.carried_masses import with_masses
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fleet_prior import FleetPrior, FleetVersion, of_its_type
from kilter_core.identify.holdout import Folds, Learned, select_learned_effects, split
from kilter_core.identify.measured_rows import as_inputs, between_rows, measurement_for
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.belonging import of_held_out, refuse_mixed_up
from kilter_core.identify.reference import is_continued, place_nominal, wanted_frames
from kilter_core.identify.scale_gauge import with_likeliest_scale
from kilter_core.identify.setup_frames import Frames, without_frames
from kilter_core.identify.uncertainty.by_view import beside_tool_error
from kilter_core.identify.views import with_cameras
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.shared_rows import refuse_shared_rows
from kilter_core.types import Floats, Ints, Progress

Validation = Observations | float | Folds | None


@dataclass(frozen=True)
class Study:
    """What every step of an identification reads.

    ``begin`` is the model to fit at its starting values, ``train`` are the rows to fit, ``validation`` the rows or folds to
    hold out. ``inside`` and ``outside`` are the numbers of both among the rows given, None unless a fraction was held out.
    ``points (m, 3)`` are the markers where their shape is known, ``remarks`` warnings of the rows, ``frames`` those of later
    set-ups, and ``fleet`` is what is known of the type.
    """

    robot: Robot
    begin: Calibration
    train: Observations
    validation: Validation
    options: IdentifyOptions
    prior: Prior | None
    points: Floats | None
    remarks: tuple[FindingDocument, ...] = ()
    frames: Frames | None = None
    fleet: FleetPrior | None = None
    inside: Ints | None = None
    outside: Ints | None = None


def prepare_study(
    robot: Robot,
    train: Observations,
    validation: Validation,
    options: IdentifyOptions,
    start: Calibration | None,
    fleet: Sequence[FleetVersion] | None,
    prior: Prior | None,
    progress: Progress,
) -> Study:
    """Build the model to fit, check the rows, lay them in one frame, and hold some of them out."""
    train, validation = as_inputs(options.make_effects(), start, train, validation)
    begin = build_start_model(robot, train, options, start)
    study = Study(robot, begin, train, validation, options, prior, begin.marker_points)
    study = replace(study, remarks=tuple(remark for check in CHECKS_BEFORE for remark in check(study)))
    study = _lay_in_one_frame(study)
    begin, of_type = of_its_type(study.begin, study.train, options, fleet)
    progress(0.02, "splitting by pose")
    return _split_rows(replace(study, begin=begin, fleet=of_type))


def build_start_model(
    robot: Robot, train: Observations, options: IdentifyOptions, start: Calibration | None
) -> Calibration:
    """The model to fit at its starting values: the effects asked for, or with none asked those of the start."""
    effects = tuple(effect.configure_for_robot(robot, train) for effect in options.make_effects())
    if start is None:
        return Calibration.nominal(robot, with_masses(effects, robot, train, options))
    begin = replace(start, doubts=())  # of the fit before
    return begin.with_effects(with_masses(effects or start.model.effects, robot, train, options))


def refuse_missing_columns(begin: Calibration, train: Observations) -> None:
    """Raise :class:`ObservationError` where an effect of the model needs a column that the rows do not have."""
    available = frozenset({"moments"} | set(train._present()))
    for effect in begin.model.effects:
        missing = effect.missing(available)
        if missing:
            raise ObservationError(
                f"Effect {effect.id} needs {', '.join(sorted(missing))}, which these observations do not have: "
                "upload the columns, or leave the effect out.",
                effect=effect.id,
                missing=sorted(missing),
            )


def _check_train(study: Study) -> Iterator[FindingDocument]:
    """Refuse rows to fit that lack a column or cannot be of this robot; warn of what only looks odd."""
    refuse_missing_columns(study.begin, study.train)
    yield from refuse_mixed_up(study.begin, study.train)


def _check_validation(study: Study) -> Iterator[FindingDocument]:
    """Refuse rows to hold out that are fitted too or cannot be of this robot; warn of those astray."""
    if isinstance(study.validation, Observations):
        refuse_shared_rows(study.train, study.validation, "validation")
        yield from of_held_out(refuse_mixed_up(study.begin, study.validation))


CHECKS_BEFORE: tuple[Callable[[Study], Iterator[FindingDocument]], ...] = (_check_train, _check_validation)


def _lay_in_one_frame(study: Study) -> Study:
    """The study with the frames of later set-ups in its model, and its rows in the frame of the first."""
    frames, validation = Frames.from_observations(study.begin, study.train, study.options), study.validation
    if frames is None:
        return study
    if isinstance(validation, Observations):
        validation = frames.laid(validation)
    begin, train = frames.in_model(study.begin), frames.laid(study.train)
    return replace(study, begin=begin, train=train, validation=validation, frames=frames)


def _split_rows(study: Study) -> Study:
    """The study with a fraction of its poses held out, where that was asked for."""
    train, validation, options = study.train, study.validation, study.options
    if not isinstance(validation, Observations | float | Folds | None):
        raise OptionError(
            f"validation is {type(validation).__name__}: give observations, a fraction of the poses, Folds, or None.",
            option="validation",
        )
    if isinstance(validation, Observations):
        return replace(study, validation=placed_later(validation))
    if not isinstance(validation, float):
        return study
    measurement_for(train, options, study.points)  # what is wrong with all rows is said of all of them
    inside, outside = split(train, validation, options.seed)
    fitted, unseen = train.select(inside), train.select(outside)
    options = between_rows(options, fitted)
    return replace(study, train=fitted, validation=unseen, options=options, inside=inside, outside=outside)


@dataclass(frozen=True)
class Fitted:
    """The fit of the rows of a study.

    ``begin`` has the cameras and the learned effects that were fitted; the ``stages`` are "nominal", "registration_only"
    and "identified"; ``arm`` is the last of them without the frames of set-ups, cameras and boards.
    """

    begin: Calibration
    measurement: Measurement
    fit: Fit
    learned: Learned | None
    stages: dict[str, Calibration]
    arm: Calibration


def fit_study(study: Study, progress: Progress) -> Fitted:
    """Register the frames of the nominal robot, then fit what the options leave free."""
    options, prior = study.options, study.prior
    measurement = measurement_for(study.train, options, study.points)
    begin = with_cameras(study.begin, study.train, measurement)
    tool = measurement.of_tool()
    registered = place_nominal(begin, tool, options, prior)
    wanted = wanted_frames(begin, registered, tool, options, is_continued(options, prior))
    begin, learned = select_learned_effects(begin, study.train, options, prior)
    found = fit_by_method(begin, measurement, options, progress, prior)
    fit = with_likeliest_scale(beside_tool_error(found))
    stages = name_stages(study, measurement, registered, fit.calibration(*wanted))
    return Fitted(begin, measurement, fit, learned, stages, without_frames(stages["identified"]))


def name_stages(
    study: Study, measurement: Measurement, registered: Calibration, identified: Calibration
) -> dict[str, Calibration]:
    """The calibrations to compare, by name; seen by cameras alone the nominal robot has no place but the registered one."""
    nominal = registered if measurement.tool.places_itself else Calibration.nominal(study.robot)
    return {"nominal": nominal, "registration_only": registered, "identified": identified}
