"""A gap search from rows to report: where the model is wrong, what is missing, how sure that is, what to measure next."""

from __future__ import annotations

from kilter_core.arm.robot import Robot
from kilter_core.gap.effect_search import search_effects
from kilter_core.gap.effect_verdicts import assess_fit, judge_effects, settle_version
from kilter_core.gap.options import GapOptions
from kilter_core.gap.outcome_warnings import Outcome
from kilter_core.gap.report.localization import localize
from kilter_core.gap.report.report import GapReport
from kilter_core.gap.report.separation import plan_next_poses
from kilter_core.gap.report_assembly import build_report
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.study import begin_study
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Progress, unheard


def find_gap(
    robot: Robot,
    observations: Observations,
    options: GapOptions | None = None,
    start: Calibration | None = None,
    validation: Observations | float | None = None,
    progress: Progress | None = None,
    confirmation: Observations | None = None,
) -> GapReport:
    """Find where the model is wrong, name what is missing, add it, and show the gap shrink on poses never used.

    ``start`` is the model to begin with (nominal geometry without one); its effects are kept and re-fitted.
    ``validation`` is other observations, or a fraction of the poses to hold out before anything is chosen; None holds
    out a quarter where there are 60 poses or more, and 0 none: then one pose is left out at a time, and nothing can be
    confirmed. ``confirmation`` is a campaign of another day or set-up: base and tool are fitted to it, nothing is chosen
    there, and what it shows with the same amplitude is replicated. ``progress(fraction, stage)`` may raise to cancel.

    Raises:
        TooFewPosesError: the geometry alone needs more poses, or base and tool of the confirmation. ObservationError:
        nothing measured, ``foreign_observations``, ``rows_shared``. OptionError: options that do not fit, a start of another.

    """
    options, progress = options or GapOptions(), progress or unheard
    study = begin_study(robot, observations, options, start, validation, confirmation, progress)
    prepared = prepare_data(study.start, study.rows, options, study.progress_within(0.0, 0.15), study.budget)
    progress(0.15, "where the model is wrong")
    where = localize(prepared.problem, prepared.visits.observations, options.seed, prepared.moving)
    search = search_effects(study, prepared)
    fit = assess_fit(study, search)
    effects, control = judge_effects(study, fit)
    version = settle_version(study, fit, effects)
    progress(0.95, "next poses and pictures")
    next_poses, told_apart = plan_next_poses(study, search, effects)
    return build_report(Outcome(study, where, fit, effects, control, version, next_poses, told_apart))
