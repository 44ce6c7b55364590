"""How long a search may take: what is cut short when the time is over, and what is said of it.

The geometry, its noise and the first scan are made whatever they take: without them there is nothing to report. Everything
else looks at the time at each of its steps, the search for wrong readings too. What was cut short never makes a claim
surer: names that were not tried on resamples or shuffles stay provisional.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from kilter_core.types import Progress

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

    def warnings(self) -> tuple[dict[str, Any], ...]:
        """Say what there was no time for."""
        if not self.left_out:
            return ()
        return (
            {
                "code": "budget_spent",
                "left_out": list(self.left_out),
                "budget_s": self.seconds,
                "message": f"The {self.seconds:g} s of the budget were not enough: this is the best that was found until then. "
                f"Left out: {'; '.join(self.left_out)}. Search again with a larger budget_s, with fewer effects, or with "
                "fewer poses.",
            },
        )
