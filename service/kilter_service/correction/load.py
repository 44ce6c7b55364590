"""The load on the tool along a path: from its columns, else from the request, else the robot's default load."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kilter_core.errors import OptionError
from kilter_service.campaigns.unstated_load import REMEDY, counted_as_nothing
from kilter_service.ground.tables.assemble import with_default_load
from kilter_service.ground.wire import to_metres, to_mm

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations

FOLLOW_THE_LOAD = frozenset({"moments", "payload_kg"})


class Carried(NamedTuple):
    """Mass (kg) and centre (mm, tool frame) as the request states them for the whole path; None: not stated."""

    payload_kg: float | None = None
    payload_com_mm: tuple[float, float, float] | None = None


def under(rows: Observations, carried: Carried, robot: Robot) -> Observations:
    """Return the rows with the load of the request, or the robot's own, where they state none.

    Raises:
        OptionError: the rows state a payload and so does the request, or the request says where but not how heavy.

    """
    if carried.payload_kg is None:
        if carried.payload_com_mm is not None:
            raise OptionError(
                "payload_com_mm says where the payload has its centre, not how heavy it is: give payload_kg too.",
                option="payload_com_mm",
            )
        return with_default_load(rows, robot)
    if rows.payload_kg is not None:
        raise OptionError(
            "The path has a column payload_kg, and payload_kg is given for the whole path too: give one of them.",
            option="payload_kg",
        )
    return rows.carrying(carried.payload_kg, [to_metres(value) for value in carried.payload_com_mm or (0.0, 0.0, 0.0)])


def load_notes(
    calibration: Calibration, stated: bool, not_corrected: Collection[str], carried: Carried
) -> tuple[str, ...]:
    """Say which load was taken where the path states none, and what that means for effects that follow the load."""
    following = _following(calibration, not_corrected)
    if stated or carried.payload_kg is not None or not following:
        return ()
    load = calibration.robot.load
    if load is not None:
        return (
            f"The path states no payload: the robot's default load was taken, {describe_load(load.mass, load.com)}.",
        )
    return (
        f"{counted_as_nothing('The path states', following)} It was corrected as with nothing on the tool. "
        f"{REMEDY.format(whole='path')}",
    )


def describe_load(mass: float, com: Sequence[float]) -> str:
    """Say a load in words."""
    at = ", ".join(f"{to_mm(value):.6g}" for value in com)
    return f"{mass:.6g} kg at ({at}) mm in the tool frame"


def _following(calibration: Calibration, not_corrected: Collection[str]) -> list[str]:
    """Effects of the arm with values that read the load, by name."""
    model = calibration.model
    return [
        key
        for (key, where), effect in zip(model.effect_slices().items(), model.effects, strict=True)
        if effect.stage != "measurement"
        and not effect.nuisance
        and effect.needs & FOLLOW_THE_LOAD
        and key not in not_corrected
        and np.any(calibration.values[where])
    ]
