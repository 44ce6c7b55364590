"""Limits of a correction as the contract has them, into the core's options: for paths, the stream and exported programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import program
from kilter_service.ground.wire import to_metres, to_rad

if TYPE_CHECKING:
    pass


def options_of(
    limits: CorrectionLimits,
    temperature_c: float | None,
    task: str | None = None,
    at_limit: str | None = None,
    hold: Sequence[int] | None = None,
) -> program.CorrectionOptions:
    """Return how to correct within the limits of a version, the arm at this temperature.

    ``task`` None is the default of the core, ``at_limit`` and ``hold`` (joints from 1) None what the limits say: as the
    stream has all three.
    """
    options = program.CorrectionOptions(
        largest_rad=to_rad(limits.max_joint_deg),
        largest_m=to_metres(limits.max_position_mm),
        farthest_m=to_metres(limits.max_position_mm),
        temperature_c=temperature_c,
        at_limit=limits.at_limit,
        held_joints=tuple(joint - 1 for joint in (limits.held_joints if hold is None else hold)),
    )
    wanted: dict[str, Any] = {"task": task, "at_limit": at_limit}
    return replace(options, **{name: value for name, value in wanted.items() if value is not None})
