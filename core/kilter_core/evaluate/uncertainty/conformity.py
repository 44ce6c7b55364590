"""Whether measured errors prove that an arm keeps a tolerance, or that it does not: ISO 14253-1.

ISO 14253-1:2017, 5: conformity is proved by measured values inside the tolerance by at least the guard band, and
nonconformity by one outside it by as much. In between neither can be proved. The guard band is the expanded uncertainty U of
the measured error, k = 2, which is wider than the 1.65 u that the standard takes by default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.parameters import mm
from kilter_core.types import Floats

Decision = Literal["accepted", "rejected", "not_proved"]


@dataclass(frozen=True)
class Conformity:
    """A decision about the largest of the errors of rows, m. ``row`` decides it: the worst for it, from 0.

    ``guard`` is the guard band there. ``needed`` is the smallest tolerance that these rows would prove.
    """

    decision: Decision
    tolerance: float
    row: int
    error: float
    guard: float
    needed: float

    def to_document(self) -> dict[str, Any]:
        """JSON-able, mm; the row counts from 1."""
        return {
            "decision": self.decision,
            "tolerance_mm": mm(self.tolerance),
            "row": self.row + 1,
            "error_mm": mm(self.error),
            "guard_band_mm": mm(self.guard),
            "provable_mm": mm(self.needed),
        }


def judge(errors: Floats, expanded: Floats, tolerance: float) -> Conformity:
    """Decide by the sizes ``errors (N,)`` m of measured errors and their ``expanded (N,)`` uncertainties, m.

    Accepted: every error and its guard band are within the tolerance. Rejected: some error is beyond it by its guard band.

    Raises:
        OptionError: no rows, or a tolerance that is not above 0.

    """
    if not np.isfinite(tolerance) or tolerance <= 0.0:
        raise OptionError(f"tolerance is {mm(tolerance):g} mm: give a number above 0.", option="tolerance_mm")
    if not len(errors):
        raise OptionError("There are no errors to decide by.", option="campaigns")
    reach, beyond = errors + expanded, errors - expanded
    row = int(np.argmax(reach))
    needed = float(reach[row])
    if needed <= tolerance:
        decision: Decision = "accepted"
    elif float(beyond.max()) > tolerance:
        decision, row = "rejected", int(np.argmax(beyond))
    else:
        decision = "not_proved"
    return Conformity(decision, tolerance, row, float(errors[row]), float(expanded[row]), needed)
