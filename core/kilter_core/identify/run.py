"""An identification from start to report: registration only, the fit, the held-out truth about both."""

from __future__ import annotations

from collections.abc import Sequence

from kilter_core.arm.robot import Robot
from kilter_core.identify.fleet_prior import FleetVersion
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.steps.findings import Outcome, estimate_uncertainty
from kilter_core.identify.steps.report import Identification, assemble_identification
from kilter_core.identify.steps.start import Validation, fit_study, prepare_study
from kilter_core.identify.steps.validation import compare_stages, cross_validate, hold_out
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Each, Progress, run_sequentially, unheard


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
    study = prepare_study(robot, train, validation, options, start, fleet, prior, progress)
    folds = cross_validate(study, each, _section(progress, 0.05, 0.45))
    fitted = fit_study(study, _section(progress, 0.5, 0.4))
    held = folds or hold_out(study, fitted)
    progress(0.95, "identifiability")
    metrics = compare_stages(study, fitted, held)
    known = estimate_uncertainty(study, fitted, held, each, _section(progress, 0.95, 0.04))
    return assemble_identification(Outcome(study, fitted, held, known), metrics)


def _section(progress: Progress, start: float, share: float) -> Progress:
    return lambda fraction, stage: progress(start + share * fraction, stage)
