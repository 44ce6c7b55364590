"""What can be asked of a gap search, checked before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.identify.options import known_options

# The best laser trackers promise 15 um near by, and arms return to a pose within 20 to 100 um: 5 um does not matter.
MATTERS_UM = 5.0
FRAME = ("free", "fixed")
# The most that is computed on request; a search with these takes minutes, and its levels change no more.
MOST = {"bootstraps": 20_000, "resamples": 10_000, "permutations": 10_000, "max_effects": 50, "next_poses": 1000}
CHOICES = {"base": FRAME, "tool": FRAME, "reference": ("auto", "robot", "registration")}


@dataclass(frozen=True)
class GapOptions:
    """Options of a gap search.

    ``alpha`` is the family-wise chance of any false name. ``effects`` restricts the library to these ids, or to
    these joints of them ({"id": ..., "joints": [2]}, from 1); all when empty. At most ``max_effects`` are named, an
    effect at several joints being one. ``noise_mm`` states the standard deviation of one coordinate when the data
    have no repeats. ``free`` and ``fix`` choose the geometric parameters as in an identification, ``base`` and
    ``tool`` are "free" or "fixed", and ``reference`` says in which frames a correction works, as there ("auto",
    "robot", "registration"). ``next_poses`` is how many poses to propose. ``matters_um`` is the movement of the
    tool below which a misfit or an effect is said to be too small to matter, unless the instrument promises less
    than that. ``refit`` ("tool",) gives every session a tool of its own. ``budget_s`` is how many seconds a search
    may take: it then ends with the best that it has.
    """

    alpha: float = 0.01
    effects: tuple[str | Mapping[str, Any], ...] = ()
    noise_mm: float | None = None
    free: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    base: str = "free"
    tool: str = "free"
    reference: str = "auto"
    max_effects: int = 8
    bootstraps: int = 1999
    resamples: int = 100
    permutations: int = 20
    next_poses: int = 12
    seed: int = 0
    matters_um: float = MATTERS_UM
    budget_s: float | None = None
    refit: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._numbers()
        if not 0.0 < self.alpha < 0.5:
            raise OptionError(f"alpha is {self.alpha}: give a chance between 0 and 0.5, as 0.01.", option="alpha")
        if self.noise_mm is not None and not self.noise_mm > 0:
            raise OptionError("noise_mm must be above 0: it is a standard deviation.", option="noise_mm")
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise OptionError(f"{name} is {getattr(self, name)!r}: give {', '.join(allowed)}.", option=name)
        if not self.matters_um >= 0.0:
            raise OptionError("matters_um must be 0 or more: it is a size in micrometres.", option="matters_um")
        if self.budget_s is not None and not self.budget_s > 0.0:
            raise OptionError("budget_s must be above 0: it is how many seconds a search may take.", option="budget_s")
        if tuple(self.refit) not in ((), ("tool",)):
            raise OptionError(f'refit is {list(self.refit)}: give ["tool"], or [].', option="refit")
        for name, most in MOST.items():
            least = 0 if name == "next_poses" else 1
            if not least <= getattr(self, name) <= most:
                raise OptionError(
                    f"{name} is {getattr(self, name)}: give a number from {least} to {most}. More would keep the worker "
                    "for hours and show nothing more.",
                    option=name,
                )

    def _numbers(self) -> None:
        """Refuse what is not a number where one is needed: 1.5 shuffles, or true."""
        for name in ("alpha", "noise_mm", "matters_um", "budget_s", "seed", *MOST):
            value = getattr(self, name)
            whole = name in MOST or name == "seed"
            kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
            if value is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
                what = "a whole number" if whole else "a number"
                raise OptionError(f"{name} is {value!r}: give {what}.", option=name)
        if self.seed < 0:
            raise OptionError(f"seed is {self.seed}: give 0 or more.", option="seed")

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> GapOptions:
        """Build options from a JSON object.

        Raises:
            OptionError: an option that does not exist or cannot be.

        """
        return GapOptions(**known_options(GapOptions, "gap", document))
