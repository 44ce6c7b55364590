"""How long a search would take here, said before it is made: its beginning is made and timed, the rest follows from that.

Every stage of a search repeats a few pieces of work: a fit, a look for wrong readings, a null distribution, a selection on
the linearised problem. Each is done once, on the machine that will search, and the selection also says how many names to
expect; how often a search repeats each of them was counted on campaigns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from kilter_core.gap.evidence.intervals import MOST_ROWS
from kilter_core.gap.evidence.stability import MANY
from kilter_core.gap.evidence.testability import Testability, to_search
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import with_testable
from kilter_core.gap.search.linearized import refit
from kilter_core.gap.search.outliers import outliers
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.search.scan import Scorer, null_of
from kilter_core.gap.search.select import Selector

T = TypeVar("T")

clock: Callable[[], float] = time.perf_counter

ALWAYS = 8.0  # null distributions that all that is made without any name takes as long as
SEARCHES = 3.0  # rounds of a search for each name: another noise, or causes instead of shapes, begin a second one
PROFILED = 6.0  # fits for the intervals of a name
DRAWN = 100.0  # resamples and shuffles that decide


@dataclass(frozen=True)
class Probe:
    """Seconds of the pieces of a search, each made once.

    ``begun`` until the geometry is fitted and wrong readings are aside, then a ``null`` distribution, a selection from
    nothing (``selected``) and ``again`` for other data on the same candidates, a ``fit`` with all that was selected, and a
    look for wrong readings (``looked``). ``names`` is how many were selected, from ``numbers`` that were measured.
    """

    begun: float
    null: float
    selected: float
    again: float
    fit: float
    looked: float
    names: int
    numbers: float

    def search(self, more: float) -> float:
        """Seconds of the whole search, on ``more`` times the rows that were looked at."""
        drawn = self.again if self.numbers * more > MANY else self.selected
        profiled = PROFILED * self.names * self.fit if self.numbers * more <= MOST_ROWS else 0.0
        rounds = SEARCHES * self.names * (more * (self.null + self.looked + self.fit) + self.selected)
        return more * self.begun + ALWAYS * more * self.null + rounds + profiled + DRAWN * min(self.names, 1) * drawn


def probe(prepared: Prepared, judged: Testability, options: GapOptions, begun: float) -> Probe:
    """Make and time the pieces of a search whose beginning took ``begun`` seconds."""
    problem, library = prepared.problem, prepared.library
    noise = problem.settings.noise
    candidates = with_testable(library, to_search(judged, library))
    scorer = Scorer.of(candidates, problem.settings.trusted, noise.freedom if noise.absolute else np.inf)
    limits = np.array([max(abs(p.lower), abs(p.upper)) for p in library.parameters])
    selector = Selector(scorer, problem.rows, limits * problem.size)
    null, made = timed(lambda: null_of(problem, scorer, [], options.bootstraps, options.seed))

    def select() -> tuple[int, ...]:
        return selector.searched(problem.gram, null.critical(options.alpha), options.max_effects)

    (chosen, first), (_, again) = timed(select), timed(select)
    _, fit = timed(lambda: refit(problem.settings, problem.values, selector.columns(chosen)))
    _, looked = timed(lambda: outliers(problem))
    return Probe(begun, made, first, again, fit, looked, len(chosen), problem.settings.numbers)


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What some work makes, and how many seconds it takes."""
    began = clock()
    out = work()
    return out, clock() - began
