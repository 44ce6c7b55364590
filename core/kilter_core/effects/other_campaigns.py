"""What a campaign takes over of laws of time that were fitted to another one, and how to say so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.effects.base import Effect
from kilter_core.effects.step import Step
from kilter_core.errors import Finding, Sentences
from kilter_core.observations import Observations
from kilter_core.observations.clock import applicable_time_mask, on_shared_clock

LATER_S = 1e7  # behind all that a campaign saw
LATER_ROWS = 10**9
CLOCK_UNKNOWN, ANOTHER_DAY = "clock_unknown", "law_of_another_day"


def carried_effects(effects: Sequence[Effect], rows: Observations) -> tuple[Effect, ...]:
    """Return the effects in rows of a campaign that they were not fitted to.

    Times since 1970 are one clock: it places a step there, and says which rows a law reaches. On any other clock a step has
    happened before all rows, and no law is applied.
    """
    shared = rows.t is not None and len(rows) > 0 and bool(on_shared_clock(rows.t).all())
    return tuple(one for effect in effects for one in _carry_over_effect(effect, shared))


def placed_later(rows: Observations) -> Observations:
    """Return rows that a job holds out of other campaigns: those whose clock or count is their own, after all it fits."""
    t = None if rows.t is None else np.where(on_shared_clock(rows.t), rows.t, rows.t + LATER_S)
    return replace(rows, t=t, row=None if rows.row is None else rows.row + LATER_ROWS)


def _carry_over_effect(effect: Effect, shared: bool) -> tuple[Effect, ...]:
    span = effect.time_span
    if shared and span is not None and on_shared_clock(np.array(span[0])):
        return (effect,)
    if isinstance(effect, Step):
        return (replace(effect, at_s=None, at_row=0),)
    return (effect,) if span is None else ()


def carried_findings(effects: Sequence[Effect], rows: Observations) -> list[Finding]:
    """Say which laws of time the rows of another campaign do without, and why."""
    spans = {effect: span for effect in effects if (span := effect.time_span) is not None}
    known = rows.t is not None and len(rows) > 0 and bool(on_shared_clock(rows.t).all())
    unknown = [e for e, span in spans.items() if not (known and on_shared_clock(np.array(span[0])))]
    other = [
        e
        for e, span in spans.items()
        if e not in unknown and rows.t is not None and not applicable_time_mask(rows.t, *span).all()
    ]
    return [_finding(code, left) for code, left in ((CLOCK_UNKNOWN, unknown), (ANOTHER_DAY, other)) if left]


def _finding(code: str, effects: Sequence[Effect]) -> Finding:
    laws = _names([e for e in effects if not isinstance(e, Step)])
    steps = _names([e for e in effects if isinstance(e, Step)])
    return Finding(code, {"effects": [e.id for e in effects]}, {"laws": laws, "steps": steps})


def _names(effects: Sequence[Effect]) -> str:
    return ", ".join(dict.fromkeys(e.id.replace("_", " ") for e in effects))


def _describe_laws(said: Mapping[str, Any]) -> str:
    """What becomes of the laws, in a sentence for each kind."""
    laws = [f"Not applied to them: {said['laws']}."] if said["laws"] else []
    return " ".join([*laws, f"Counted as having happened before them: {said['steps']}."] if said["steps"] else laws)


SENTENCES: Sentences = {
    CLOCK_UNKNOWN: lambda said: (
        f"Nothing says when these rows were measured, as against those of the fit. {_describe_laws(said)} "
        "Give both files time stamps with a date."
    ),
    ANOTHER_DAY: lambda said: f"These rows were measured on another day than those of the fit. {_describe_laws(said)}",
}
