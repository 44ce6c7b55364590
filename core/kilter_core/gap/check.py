"""What a search could test in some rows, before it is made: the geometry is fitted, nothing is searched."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.gap.evidence.fits.intervals import MOST_ROWS
from kilter_core.gap.evidence.halves import restrict_to_visits
from kilter_core.gap.evidence.similarity.testability import (
    Testability,
    Visible,
    testability,
    to_search,
    untestable,
    visible,
)
from kilter_core.gap.evidence.stability import FEW, MANY, reweight_problem
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import Library, Untestable, with_testable
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.linear.linearized import refit
from kilter_core.gap.search.outliers import outliers
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.gap.search.scan import Scorer, null_distribution
from kilter_core.gap.search.select import HIDING, Selector
from kilter_core.gap.study import beginning, refuse_other_confirmation, split_held_out_rows
from kilter_core.identify.comparison import count_poses, thin_poses
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import is_trajectory
from kilter_core.types import unheard

# How long a search would take here, said before it is made: its beginning is made and timed, the rest follows from
# that.
#
# Every stage of a search repeats a few pieces of work: a fit, a look for wrong readings, a null distribution, a
# selection on the linearised problem. Each is done once, on the machine that will search, and the selection also
# says how many names to expect, and whether they leave something: then no verdict waits for resamples, of which a
# few are drawn, but both halves of the campaign are asked. How often a search repeats each piece was counted on
# campaigns.

T = TypeVar("T")

clock: Callable[[], float] = time.perf_counter

ALWAYS = 8.0  # null distributions that all that is made without any name takes as long as
SEARCHES = 3.0  # rounds of a search for each name: another noise, or causes instead of shapes, begin a second one
PROFILED = 6.0  # fits for the intervals of a name
DECIDING = 40.0  # resamples that decide where all return a name: the second look at them leaves no doubt


@dataclass(frozen=True)
class Probe:
    """Seconds of the pieces of a search, each made once.

    ``begun`` until the geometry is fitted and wrong readings are aside, then a ``null`` distribution, a selection from
    nothing (``selected``), from either of the ``halves`` of the campaign and ``again`` from a resample, a ``fit`` with all
    that was selected, and a look for wrong readings (``looked``). ``names`` is how many were selected, from ``numbers``
    that were measured; ``settled`` whether they leave nothing and poses that they were not selected from can judge them.
    """

    begun: float
    null: float
    selected: float
    halves: float
    again: float
    fit: float
    looked: float
    names: int
    numbers: float
    settled: bool

    def search(self, more: float) -> float:
        """Seconds of the whole search, on ``more`` times the rows that were looked at."""
        profiled = PROFILED * self.names * self.fit if self.numbers * more <= MOST_ROWS else 0.0
        rounds = SEARCHES * self.names * (more * (self.null + self.looked + self.fit) + self.selected)
        tried = DECIDING * self.again if self.settled else FEW * self.again + self.halves
        return more * self.begun + ALWAYS * more * self.null + rounds + profiled + min(self.names, 1) * tried


def probe(prepared: Prepared, judged: Testability, options: GapOptions, begun: float, unseen: bool) -> Probe:
    """Make and time the pieces of a search whose beginning took ``begun`` seconds; ``unseen`` poses judge what it finds."""
    problem, library = prepared.problem, prepared.library
    noise = problem.settings.noise
    candidates = with_testable(library, to_search(judged, library))
    scorer = Scorer.from_candidates(candidates, problem.settings.trusted, noise.freedom if noise.absolute else np.inf)
    limits = np.array([max(abs(p.lower), abs(p.upper)) for p in library.parameters])
    selector = Selector(scorer, problem.rows, limits * problem.size)
    null, made = run_and_time(lambda: null_distribution(problem, scorer, [], options.bootstraps, options.seed))

    def select(gram: Gram, by: Selector, most: int) -> tuple[int, ...]:
        return by.select_candidates(gram, null.critical(options.alpha), most)

    chosen, first = run_and_time(lambda: select(problem.gram, selector, options.max_effects))
    visits = np.arange(len(problem.settings.used))
    before = 2 * visits < len(visits)
    sides = [restrict_to_visits(problem, side) for side in (before, ~before)]
    _, halves = run_and_time(
        lambda: [select(half, replace(selector, rows=n), options.max_effects) for half, n in sides]
    )
    drawn = np.random.default_rng(options.seed).exponential(size=len(visits))
    alone = replace(selector, pairs=scorer.absolute)
    many = problem.rows > MANY  # the candidates of a resample are those of the data
    other = problem.gram.with_data(problem.gram.c, problem.gram.yy)
    weight, most = drawn[problem.row_visit], selector.names(chosen) + 2
    _, again = run_and_time(lambda: select(other if many else reweight_problem(problem, weight), alone, most))
    _, fit = run_and_time(lambda: refit(problem.settings, problem.values, selector.columns(chosen)))
    _, looked = run_and_time(lambda: outliers(problem))
    left = problem.gram.condition_on_columns(selector.columns(chosen))
    settled = unseen and scorer.absolute and left.yy < left.nu + HIDING * np.sqrt(2.0 * max(left.nu, 1.0))
    numbers = problem.settings.numbers
    return Probe(begun, made, first, halves, again, fit, looked, len(chosen), numbers, bool(settled))


def run_and_time(work: Callable[[], T]) -> tuple[T, float]:
    """What some work makes, and how many seconds it takes."""
    began = clock()
    out = work()
    return out, clock() - began


MOST_POSES = 500  # looked at: half a second


@dataclass(frozen=True)
class GapCheck:
    """What can be tested at the geometry-only fit, and what not; a search that names effects may see more by the end.

    ``poses`` were looked at ``of`` those to search: what fewer poses show is scaled to what all of them would show.
    ``seconds`` is how long the search would take on this machine, without a budget.
    """

    testable: tuple[Visible, ...]
    not_testable: tuple[Untestable, ...]
    poses: int
    of: int
    seconds: float


def check_gap(
    robot: Robot,
    observations: Observations,
    options: GapOptions | None = None,
    start: Calibration | None = None,
    validation: Observations | float | None = None,
    confirmation: Observations | None = None,
) -> GapCheck:
    """Say which effects a search with these options could test in the rows it would search.

    Raises:
        TooFewPosesError, ObservationError, OptionError: what the search would be refused with.

    """
    options = options or GapOptions()
    begin = beginning(robot, start, observations, options)
    given = (one for one in (observations, validation) if isinstance(one, Observations))
    refuse_other_confirmation(robot, begin, given, confirmation)

    def begun() -> tuple[Observations, Observations, bool, Prepared]:
        refuse_mixed_up(begin, observations)
        (seen_rows, unseen_rows), _, _ = seen_poses(begin, observations, validation)
        searched, held = split_held_out_rows(seen_rows, unseen_rows, options.seed)
        rows = _fewer(searched)
        return searched, rows, held is not None, prepare_data(begin, rows, options, unheard)

    (searched, rows, held_out, prepared), took = run_and_time(begun)
    unseen = held_out or confirmation is not None
    seen = testability(prepared.problem, prepared.library)
    judged = _extrapolate_to_all_rows(seen, prepared.library, len(rows) / len(searched))
    return GapCheck(
        tuple(visible(prepared.library, judged)),
        untestable(prepared.library, judged, prepared.problem, prepared.visits.observations),
        count_poses(rows),
        count_poses(searched),
        probe(prepared, seen, options, took, unseen).search(len(searched) / len(rows)),
    )


def _fewer(rows: Observations) -> Observations:
    """At most ``MOST_POSES`` poses, evenly chosen, with their repeats; motions stay, a search averages them by itself."""
    return rows if is_trajectory(rows) or count_poses(rows) <= MOST_POSES else thin_poses(rows, MOST_POSES)


def _extrapolate_to_all_rows(judged: Testability, library: Library, share: float) -> Testability:
    """What all rows would show, where a ``share`` of them was looked at: amplitudes fall with the root of the rows."""
    smallest = judged.smallest * np.sqrt(share)
    limit = np.array([max(abs(p.lower), abs(p.upper)) for p in library.parameters])
    return replace(judged, smallest=smallest, able=np.isfinite(smallest) & (smallest <= limit))
