"""What can be asked of a gap hunt, checked before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from core.errors import OptionError

FRAME = ("free", "fixed")
CHOICES = {"base": FRAME, "tool": FRAME, "reference": ("auto", "robot", "registration")}


@dataclass(frozen=True)
class GapOptions:
    """Options of a gap hunt.

    ``alpha`` is the family-wise chance of any false name. ``effects`` restricts the library to these ids (all when
    empty). ``noise_mm`` states the standard deviation of one coordinate when the data have no repeats. ``free`` and
    ``fix`` choose the geometric parameters as in an identification, ``base`` and ``tool`` are "free" or "fixed",
    and ``reference`` says in which frames a correction works, as there ("auto", "robot", "registration").
    ``next_poses`` is how many poses to propose.
    """

    alpha: float = 0.01
    effects: tuple[str, ...] = ()
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

    def __post_init__(self) -> None:
        if not 0.0 < self.alpha < 0.5:
            raise OptionError(f"alpha is {self.alpha}: give a chance between 0 and 0.5, as 0.01.", option="alpha")
        if self.noise_mm is not None and not self.noise_mm > 0:
            raise OptionError("noise_mm must be above 0: it is a standard deviation.", option="noise_mm")
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise OptionError(f"{name} is {getattr(self, name)!r}: give {', '.join(allowed)}.", option=name)
        for name in ("bootstraps", "resamples", "permutations", "max_effects"):
            if getattr(self, name) < 1:
                raise OptionError(f"{name} must be at least 1.", option=name)

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> GapOptions:
        """Build options from a JSON object.

        Raises:
            OptionError: an option that does not exist or cannot be.

        """
        known = {f.name for f in fields(GapOptions)}
        unknown = sorted(set(document) - known)
        if unknown:
            raise OptionError(
                f"gap has no option {unknown[0]!r}. It has: {', '.join(sorted(known))}.", option=unknown[0]
            )
        made: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in document.items()}
        return GapOptions(**made)
