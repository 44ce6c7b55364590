"""Readings outside the limits of their joints: collected over a whole upload, then named or refused all at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.types import Floats
from kilter_service.ground.tables.columns import Column

if TYPE_CHECKING:
    from kilter_core.arm import Joint


# Many URDFs round limits to two decimals of a radian (2.09 for 120 deg), and to a mm for a prismatic joint.
TOLERANCE = {"deg": math.radians(0.3), "mm": 0.5e-3}
# Arms move some degrees beyond what their drawing states; a wrong unit, sign or joint goes further in some row.
DOUBTFUL = {"deg": math.radians(10.0), "mm": 20e-3}
MOST_ROWS = 1000  # that are named one by one in the error's context
SHOWN = 8
BEYOND_LIMITS = "beyond_limits"


@dataclass
class _Outside:
    column: Column
    joint: Joint
    rows: list[int] = field(default_factory=list)
    count: int = 0
    worst: float = 0.0  # rad or m beyond
    reading: float = 0.0  # the first one, in the column's unit

    @property
    def unit(self) -> str:
        return "mm" if self.joint.kind == "prismatic" else "deg"

    def add_readings(self, first: int, cells: Floats) -> None:
        q = cells * self.column.factor
        beyond = np.maximum(self.joint.lower - q, q - self.joint.upper)
        rows = np.flatnonzero(beyond > TOLERANCE[self.unit])
        if not len(rows):
            return
        if not self.count:
            self.reading = float(cells[rows[0]])
        self.count += len(rows)
        self.rows += (rows[: MOST_ROWS - len(self.rows)] + first).tolist()
        self.worst = max(self.worst, float(beyond[rows].max()))

    @property
    def is_doubtful(self) -> bool:
        """Whether all are so near that the limits may be wrong, and not the rows."""
        return self.worst <= DOUBTFUL[self.unit]

    def limits(self) -> str:
        low, high = self.joint.lower / self.column.factor, self.joint.upper / self.column.factor
        return f"{low:.6g} to {high:.6g} of joint {self.joint.name!r}"

    def describe_violation(self) -> str:
        size = self.worst * (1e3 if self.unit == "mm" else 180.0 / math.pi)
        more = f" and {self.count - SHOWN} more" if self.count > SHOWN else ""
        rows = ", ".join(map(str, self.rows[:SHOWN]))
        return f"column {self.column.name!r} (limits {self.limits()}) row {rows}{more}, by up to {size:.3g} {self.unit}"


class JointLimits:
    """The readings of one upload; `check` every piece, then `finish`."""

    def __init__(self) -> None:
        self._found: dict[str, _Outside] = {}

    def check(self, column: Column, joint: Joint, cells: Floats, first: int) -> None:
        """Look at the next readings of a joint; ``first`` is the number of the first row."""
        self._found.setdefault(column.name, _Outside(column, joint)).add_readings(first, cells)

    def finish(self) -> tuple[dict[str, Any], ...]:
        """Return a warning about readings a little outside the limits; refuse others.

        Raises:
            ObservationError: readings far outside the limits; all columns and rows are named.

        """
        found = [one for one in self._found.values() if one.count]
        if not found:
            return ()
        rows = sorted({row for one in found for row in one.rows})[:MOST_ROWS]
        listed = "; ".join(one.describe_violation() for one in found)
        if all(one.is_doubtful for one in found):
            what = f"Readings are a little outside the limits of their joints: {listed}. "
            what += "They count. Correct the limits of the robot, or leave these rows out."
            return ({"code": BEYOND_LIMITS, "message": what, "rows": rows},)
        first = min(found, key=lambda one: one.rows[0])
        count = sum(one.count for one in found)
        remedy = "correct the row or the robot" if count == 1 else "correct the rows or the robot"
        radians = [f"{one.column.name[:-3]}deg" for one in found if one.column.name.endswith("_rad")]
        if radians:
            remedy += f", or name the column{'s' if len(radians) > 1 else ''} {', '.join(radians)} if these are degrees"
        if count == 1:
            what = f"Row {rows[0]}, column {first.column.name!r} is outside the limits {first.limits()}: {remedy} "
            what += f"({first.reading:.9g})."
        else:
            what = (
                f"{count} readings are outside the limits of their joints: {listed}. {remedy[0].upper()}{remedy[1:]}."
            )
        raise ObservationError(what, row=rows[0], column=first.column.name, rows=rows)
