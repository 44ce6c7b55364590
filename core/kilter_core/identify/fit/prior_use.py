"""How far an arm was believed to be as its type: used, widened or dropped, and the test that said so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class PriorUse:
    """What became of a prior: ``widened_by`` times its standard deviations it was taken, None where it was dropped.

    ``odd`` parameters are those of which the arm is not as its type: there the rows alone say. ``chi_square`` compares the
    arm with its type in ``compared`` directions that the rows tell, the odd left to them, with the chance ``p_value`` that
    an arm of the type is as far off. ``limited_by`` is the part of ``widened_by`` that keeps the type from moving the tool by
    more than a share of what the rows leave open. ``noise`` is that of the rows, in those of the fit that judged the arm.
    """

    state: Literal["used", "widened", "dropped"]
    widened_by: float | None
    chi_square: float
    compared: int
    p_value: float
    odd: tuple[str, ...] = ()
    limited_by: float = 1.0
    noise: float = 1.0

    def to_document(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "state": self.state,
            "widened_by": self.widened_by,
            "chi_square": self.chi_square,
            "compared": self.compared,
            "p_value": self.p_value,
            "odd": list(self.odd),
            "limited_by": self.limited_by,
        }
