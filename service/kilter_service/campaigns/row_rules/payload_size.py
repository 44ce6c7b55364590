"""Payloads that no arm of this size carries: most often grams that were stated as kilograms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.types import Floats
from kilter_service.ground.tables.columns import Column
from kilter_service.robots.likely_payload import heaviest_likely_payload

if TYPE_CHECKING:
    from kilter_core.arm import Robot

UNLIKELY = "payload_unlikely"


def payload_warning(robot: Robot, payload_kg: float, where: str) -> dict[str, Any] | None:
    """Return the warning about a payload, None where an arm of this size may carry it."""
    most, why = heaviest_likely_payload(robot)
    if not payload_kg > most:
        return None
    what = (
        f"{where} is {payload_kg:.6g} kg, but {why}. Is it in grams? Then divide it by 1000 ({payload_kg / 1e3:.4g} kg) "
        'or write unit = "g" in the column map, and upload the rows as a new campaign.'
    )
    return {"code": UNLIKELY, "message": what}


class PayloadSize:
    """The payloads of one upload: take every piece, then ask for `warnings`."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._largest: tuple[float, str] = (0.0, "")

    def add_payloads(self, column: Column, cells: Floats) -> None:
        """Remember the largest payload of the next rows."""
        self._largest = max(self._largest, (float(np.nanmax(cells, initial=0.0)) * column.factor, column.name))

    def warnings(self) -> tuple[dict[str, Any], ...]:
        """Return the warning about the largest payload, if there is one."""
        found = payload_warning(self._robot, self._largest[0], f"The payload (column {self._largest[1]!r})")
        return () if found is None else (found,)
