"""How a search begins: its start and its rows, what is refused before anything is fitted, and which poses it never sees.

Leave-one-out after a selection is not held out: the same poses chose the name. Of pure noise the best of all candidates
gains on poses left out one at a time in 92 % of campaigns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS
from kilter_core.effects.laws import placed_later
from kilter_core.errors import FindingDocument, ObservationError, OptionError
from kilter_core.gap.evidence.replication import refuse_unfit
from kilter_core.gap.options import Budget, GapOptions
from kilter_core.gap.search.candidates import joints_by_effect
from kilter_core.gap.search.events import with_row_numbers
from kilter_core.identify.holdout import split
from kilter_core.identify.measured_rows import as_inputs
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.identify.views import PlannedViews
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import group_contacts, placements
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.clock import clock_warnings
from kilter_core.observations.shared_rows import refuse_shared_rows
from kilter_core.types import Ints, Progress

SHIFT = "session_shift"
SHARE = 0.25  # of the poses, held out when nothing else is asked
POSES_TO_SPARE_SOME = 60  # poses from which so many can be spared
FEWEST_PLACEMENTS = 4  # of contacts, from which one can be spared unasked


@dataclass(frozen=True)
class Study:
    """What every step of a search reads.

    ``rows`` are searched and ``validation`` is held out; ``numbers`` are theirs among the rows given, from 0. ``every`` is
    both of them, where they came in one file. ``remarks`` are what the checks before the fit say.
    """

    robot: Robot
    start: Calibration
    options: GapOptions
    rows: Observations
    validation: Observations | None
    confirmation: Observations | None
    every: Observations
    numbers: tuple[Ints, Ints]
    by_views: PlannedViews | None
    progress: Progress
    budget: Budget
    remarks: tuple[FindingDocument, ...]

    def progress_within(self, low: float, high: float) -> Progress:
        """Return a progress that maps a stage's own fraction into its share of the whole."""
        return lambda fraction, stage: self.progress(low + (high - low) * min(1.0, fraction), stage)

    def stage_progress(self, low: float, high: float, stage: str) -> Callable[[float], None]:
        """Return the same for a stage that has one name."""
        return lambda fraction: self.progress_within(low, high)(fraction, stage)


def refuse_other_confirmation(
    robot: Robot, start: Calibration, rows: Iterable[Observations | None], confirmation: Observations | None
) -> None:
    """Refuse a confirmation of another arm, one that holds some of the ``rows``, and one that is too small."""
    if confirmation is not None:
        for one in rows:
            if one is not None:
                refuse_unfit(robot, one, confirmation)
        refuse_mixed_up(start, confirmation)


def _check_confirmation(study: Study) -> tuple[FindingDocument, ...]:
    refuse_other_confirmation(study.robot, study.start, (study.rows, study.validation), study.confirmation)
    return ()


# Before the fit, in this order: each refuses what cannot be searched, and returns what only looks odd.
BEFORE: tuple[Callable[[Study], Iterable[FindingDocument]], ...] = (
    _check_confirmation,
    lambda study: refuse_mixed_up(study.start, study.rows),
    lambda study: clock_warnings(study.rows),
    lambda study: study.remarks,
)


def begin_study(
    robot: Robot,
    observations: Observations,
    options: GapOptions,
    start: Calibration | None,
    validation: Observations | float | None,
    confirmation: Observations | None,
    progress: Progress,
) -> Study:
    """Return the study of a search; arguments and errors as of :func:`~kilter_core.gap.find.find_gap`."""
    begin, budget = beginning(robot, start, observations, options), Budget(options.budget_s)
    named = [EFFECTS[name] for name in joints_by_effect(options.effects)]
    given = as_inputs(named, begin, observations, validation, confirmation)
    (rows, validation, confirmation), by_views, odd = seen_poses(begin, *given)
    rows, own = with_row_numbers(rows), validation if isinstance(validation, Observations) else None
    numbers = np.arange(len(rows)), np.arange(0 if own is None else len(own))
    study = Study(robot, begin, options, rows, own, confirmation, rows, numbers, by_views, progress, budget, odd)
    remarks = tuple(one for check in BEFORE for one in check(study))
    searched, unseen = split_held_out_rows(rows, validation, options.seed)
    if not isinstance(validation, Observations):
        numbers = held_out(rows, validation, options.seed)
    return replace(study, rows=searched, validation=unseen, numbers=numbers, remarks=remarks)


def beginning(robot: Robot, start: Calibration | None, rows: Observations, options: GapOptions) -> Calibration:
    """The start, which is the nominal robot where none is given.

    Raises:
        OptionError: a start of another robot, whose chain would be searched and what differs named as physics;
        tools of sessions where ``rows`` have fewer than two.

    """
    if start is None:
        return _with_tool_per_session(Calibration.nominal(robot), rows, options)
    if (start.robot.name, start.robot.chain.elements) != (robot.name, robot.chain.elements):
        raise OptionError(
            f"The start is a version of robot {start.robot.name!r}, the rows are of {robot.name!r}: name a version of "
            f"{robot.name!r}, or leave start out.",
            option="start",
        )
    return _with_tool_per_session(replace(start, doubts=()), rows, options)


def _with_tool_per_session(begin: Calibration, rows: Observations, options: GapOptions) -> Calibration:
    """Every session after the first has a tool of its own from the start, so that no step need be named for it."""
    if not options.refit or any(effect.id == SHIFT for effect in begin.model.effects):
        return begin
    if rows.session is None or len(set(rows.session.tolist())) < 2:
        raise OptionError(
            "A tool for each campaign and session needs two of them, and the rows are of one: name both campaigns, give "
            "the rows from where the marker was mounted again on another session number, or leave refit out.",
            option="refit",
        )
    return begin.with_effects([*begin.model.effects, EFFECTS[SHIFT]().configure_for_robot(begin.robot, rows)])


def held_out_share(rows: Observations, validation: float | None) -> float:
    """Share of the poses that is held out; None asks for a quarter where there are 60 poses or more, 0 for none.

    Of contacts whole placements are held out, unasked where there are four or more.
    """
    if validation is not None:
        if not 0.0 <= validation < 1.0:
            raise OptionError(
                f"validation is {validation}: give a fraction from 0 (nothing held out) to below 1.",
                option="validation",
            )
        return float(validation)
    placed = placements(rows)
    if placed is not None and len(placed[1]) < FEWEST_PLACEMENTS:
        return 0.0
    return SHARE if len(rows) and int(rows.pose_groups().max()) + 1 >= POSES_TO_SPARE_SOME else 0.0


def held_out(rows: Observations, validation: float | None, seed: int) -> tuple[Ints, Ints]:
    """Row indices (train, held out), the same that an identification holds out of these rows with this share and seed.

    Raises:
        OptionError: a fraction outside [0, 1). TooFewPosesError: a side without poses.

    """
    share = held_out_share(rows, validation)
    if share == 0.0:
        return np.arange(len(rows)), np.zeros(0, dtype=np.int64)
    return split(rows, share, seed)


def split_held_out_rows(
    rows: Observations, validation: Observations | float | None, seed: int
) -> tuple[Observations, Observations | None]:
    """Rows to search and rows that take no part in it, None without any.

    Raises:
        ObservationError: ``rows_shared``, where other observations repeat rows that are searched. OptionError: a
        fraction outside [0, 1).

    """
    if isinstance(validation, Observations):
        refuse_shared_rows(rows, validation, "validation")
        _refuse_other_contacts(rows, validation)
        return rows, placed_later(validation)
    inside, outside = held_out(rows, validation, seed)
    return (rows, None) if not len(outside) else (rows.select(inside), rows.select(outside))


def _refuse_other_contacts(rows: Observations, validation: Observations) -> None:
    """Refuse validation rows whose tool was measured otherwise where contacts held either, and contacts too small to judge."""
    widths = [{3 if c.kind == "socket" else 1 for c in group_contacts(part)} for part in (rows, validation)]
    if widths[0] != widths[1]:
        raise ObservationError(
            "The rows to search and those to validate measure the tool in different ways: sockets, planes and bars, or an "
            "instrument. Name a campaign of the same kind to validate, and this one as the confirmation.",
            code="contacts_mixed",
        )
    if widths[1]:
        Measurement.from_observations(validation, held=True)
