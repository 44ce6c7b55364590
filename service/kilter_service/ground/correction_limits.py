"""Limits of a correction into the core's options, and which effects of a version a correction leaves out."""

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


COLUMNS = {"temperature_c": "temperature_c", "base_tilt_x": "base_tilt_x_deg", "base_tilt_y": "base_tilt_y_deg"}


def where_sentences(where_stated: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Say where effects are corrected that are left out of rows which do not state what they follow."""
    names: dict[tuple[str, ...], list[str]] = {}
    for name, asked in where_stated.items():
        names.setdefault(tuple(asked), []).append(name)
    return tuple(_describe_correction_scope(asked, who) for asked, who in names.items())


def sentence(unsupported: Sequence[str], where_stated: Mapping[str, Sequence[str]], by: str = "at run time") -> str:
    """Say what is left out ``by`` a correction and where it is not; empty: nothing is left out."""
    never = [name for name in unsupported if name not in where_stated]
    said = [f"Not corrected {by}: {', '.join(never)}."] if never else []
    return " ".join((*said, *where_sentences(where_stated)))


def fields(unsupported: Sequence[str], where_stated: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """What an answer says of it: ``unsupported_effects``, ``corrected_where_stated``, ``not_corrected``."""
    return {
        "unsupported_effects": list(unsupported),
        "corrected_where_stated": {name: [COLUMNS[one] for one in asked] for name, asked in where_stated.items()},
        "not_corrected": sentence(unsupported, where_stated),
    }


def _describe_correction_scope(asked: Sequence[str], names: Sequence[str]) -> str:
    columns = " and ".join(COLUMNS[one] for one in asked)
    where = f"in files and paths, whose rows must state {columns}"
    if tuple(asked) == ("temperature_c",):
        where = f"in rows that state {columns}, in all others and in a stream with KILTER_TEMPERATURE_C"
    return f"Corrected only {where}: {', '.join(names)}."
