"""Limits of a correction as the contract has them, into the core's options: for paths, the stream and exported programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_correct
from kilter_service.ground.wire import to_metres, to_rad

# What the limits of a version and the conditions of the rows say. All else is a rule: how this release corrects.
NO_RULES = frozenset(
    {
        "largest_rad",
        "largest_m",
        "farthest_m",
        "at_limit",
        "held_joints",
        "temperature_c",
        "payload_kg",
        "payload_com",
        "base_tilt",
        "link_masses",
    }
)
Rules = Mapping[str, Any]


def rules_today() -> dict[str, Any]:
    """Return the task and the rules by which this release corrects."""
    options = asdict(core_correct.CorrectionOptions(task=core_correct.DEFAULT_TASK))
    return {name: value for name, value in options.items() if name not in NO_RULES}


def correction_options(
    limits: CorrectionLimits,
    temperature_c: float | None,
    task: str | None = None,
    at_limit: str | None = None,
    hold: Sequence[int] | None = None,
    rules: Rules | None = None,
) -> core_correct.CorrectionOptions:
    """Return how to correct within the limits of a version, the arm at this temperature.

    ``rules`` are those that the version was activated under, None today's. ``task`` None is theirs, ``at_limit`` and
    ``hold`` (joints from 1) None what the limits say: as the stream has all three.
    """
    known = rules_today() if rules else {}
    kept = {name: value for name, value in (rules or {}).items() if name in known}
    options = core_correct.CorrectionOptions(
        **kept,
        largest_rad=to_rad(limits.max_joint_deg),
        largest_m=to_metres(limits.max_position_mm),
        farthest_m=to_metres(limits.max_position_mm),
        temperature_c=temperature_c,
        at_limit=limits.at_limit,
        held_joints=tuple(joint - 1 for joint in (limits.held_joints if hold is None else hold)),
    )
    wanted: dict[str, Any] = {"task": task, "at_limit": at_limit}
    return replace(options, **{name: value for name, value in wanted.items() if value is not None})
