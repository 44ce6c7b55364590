"""What can be asked of a gap search, checked before anything is computed; and how long it may take.

The geometry, its noise and the first scan are made whatever they take: without them there is nothing to report. Everything
else looks at the time at each of its steps, the search for wrong readings too. What was cut short never makes a claim
surer: names that were not tried on resamples or shuffles stay provisional.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from kilter_core.effects.base import option
from kilter_core.errors import FindingDocument, OptionError
from kilter_core.identify.options import (
    FRAME,
    MOST_SEED,
    REFERENCE,
    REFERENCES,
    SEED,
    known_options,
    refuse_undeclared_values,
)
from kilter_core.types import Progress

# The best laser trackers promise 15 um near by, and arms return to a pose within 20 to 100 um: 5 um does not matter.
MATTERS_UM = 5.0


@dataclass(frozen=True)
class GapOptions:
    """Options of a gap search. Those declared with ``option`` are options of the job, too, and of its commands.

    ``effects`` restricts the library to these ids, or to these joints of them ({"id": ..., "joints": [2]}, from 1); all
    when empty. ``free`` and ``fix`` choose the geometric parameters as in an identification. Below ``matters_um`` a misfit
    or an effect is said to be too small to matter, unless the instrument promises less than that. ``refit`` ("tool",)
    gives every session a tool of its own.
    """

    alpha: float = option(0.01, "Chance of any false name in the whole search, between 0 and 0.5.", above=0, below=0.5)
    effects: tuple[str | Mapping[str, Any], ...] = ()
    noise_mm: float | None = option(
        None, "Standard deviation of a coordinate, mm, above 0, where no pose was measured twice.", above=0.0
    )
    free: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    base: str = option("free", "Whether the base is fitted.", choices=FRAME)
    tool: str = option("free", "Whether the tool is fitted.", choices=FRAME)
    reference: str = option("auto", REFERENCE, choices=REFERENCES)
    # The most of each is what a search of minutes computes; more changes its levels no further.
    max_effects: int = option(8, "Most effects to name, 1 to 50; an effect at several joints is one.", low=1, high=50)
    bootstraps: int = option(1999, "Resamples behind the p-value of an effect, 1 to 20000.", low=1, high=20_000)
    resamples: int = option(100, "Resamples of poses on which a name must return, 1 to 10000.", low=1, high=10_000)
    permutations: int = option(20, "Shuffles of the negative control, 1 to 10000.", low=1, high=10_000)
    next_poses: int = option(12, "Poses to propose, 0 to 1000.", low=0, high=1000)
    seed: int = option(0, SEED, low=0, high=MOST_SEED)
    matters_um: float = option(
        MATTERS_UM, "Movement of the tool below which nothing matters, micrometres (um), 0 or more.", low=0.0
    )
    budget_s: float | None = option(
        None,
        "Seconds that a search may take, above 0: it then ends with the best it has; null: as many as it needs.",
        above=0.0,
    )
    refit: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        refuse_undeclared_values(self)
        if tuple(self.refit) not in ((), ("tool",)):
            raise OptionError(f'refit is {list(self.refit)}: give ["tool"], or [].', option="refit")

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> GapOptions:
        """Build options from a JSON object.

        Raises:
            OptionError: an option that does not exist or cannot be.

        """
        return GapOptions(**known_options(GapOptions, "gap", document))


clock: Callable[[], float] = time.monotonic

# Share of the time after which a stage is cut short; the next has the rest.
PREPARING = 0.25
SEARCHING = 0.5
MEASURING = 0.7
RESAMPLING = 0.85
SHUFFLING = 0.92
PLANNING = 0.95


class OutOfTimeError(Exception):
    """A stage ran out of its share of the time."""


@dataclass
class Budget:
    """``seconds`` for a whole search, None for as many as it takes; ``left_out`` is what there was no time for."""

    seconds: float | None = None
    left_out: list[str] = field(default_factory=list)
    began: float = field(init=False)

    def __post_init__(self) -> None:
        self.began = clock()

    def over(self, share: float, what: str) -> bool:
        """Whether this ``share`` of the time is over: then ``what`` is noted as left out."""
        if self.seconds is None or clock() - self.began <= share * self.seconds:
            return False
        if what not in self.left_out:
            self.left_out.append(what)
        return True

    def tick(self, share: float, what: str) -> Callable[[], None]:
        """What a stage calls at each of its steps.

        Raises:
            OutOfTimeError: from the call, when its ``share`` is over.

        """

        def check_deadline() -> None:
            if self.over(share, what):
                raise OutOfTimeError

        return check_deadline

    def ending(self, progress: Progress, share: float, what: str) -> Progress:
        """The same progress, which ends a stage whose ``share`` is over.

        Raises:
            OutOfTimeError: from the progress, when it is.

        """

        def report_and_check_deadline(fraction: float, stage: str) -> None:
            progress(fraction, stage)
            if self.over(share, what):
                raise OutOfTimeError

        return report_and_check_deadline if self.seconds is not None else progress

    def warnings(self) -> tuple[FindingDocument, ...]:
        """Say what there was no time for."""
        if not self.left_out:
            return ()
        return (
            FindingDocument.make(
                "budget_spent",
                f"The {self.seconds:g} s of the budget were not enough: this is the best that was found until then. "
                f"Left out: {'; '.join(self.left_out)}. Search again with a larger budget_s, with fewer effects, or with "
                "fewer poses.",
                left_out=list(self.left_out),
                budget_s=self.seconds,
            ),
        )
