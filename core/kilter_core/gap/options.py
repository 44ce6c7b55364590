"""What can be asked of a gap search, checked before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kilter_core.effects.base import option
from kilter_core.errors import OptionError
from kilter_core.identify.options import (
    FRAME,
    MOST_SEED,
    REFERENCE,
    REFERENCES,
    SEED,
    known_options,
    refuse_undeclared_values,
)

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
