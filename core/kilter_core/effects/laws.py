"""What effects share of time, temperature and single events: on which clock, from which temperature, before which row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import Separator
from kilter_core.errors import Finding, OptionError, Sentences
from kilter_core.observations import Observations
from kilter_core.observations.clock import applicable_time_mask, on_shared_clock
from kilter_core.types import Floats

SHARES = (0.07, 0.14, 0.27, 0.52)  # time constants, of the campaign: nearer ones look the same


@dataclass(frozen=True)
class LawOfTime(Effect):
    """Something moves with the time since ``t0_s``, when all is where the geometry says.

    It holds on its own clock, from half a day before ``t0_s`` to half a day after ``until_s``. In other rows the geometry
    holds alone. Laws of earlier releases have no ``until_s`` and hold on their whole clock.
    """

    needs = frozenset({"t"})
    clock = "t"

    t0_s: float | None = option(None, "When it began, s on the clock of the rows; null: the earliest row.")
    until_s: float | None = option(
        None, "Last time that it was fitted to, s: half a day later it is not applied; null: the last row."
    )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Begin at the earliest row and end at the last one."""
        if rows is None or rows.t is None or not len(rows):
            return self
        begin, end = span_of_clock(rows.t)
        return replace(
            self,
            t0_s=begin if self.t0_s is None else self.t0_s,
            until_s=end if self.until_s is None else self.until_s,
        )

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """When it begins and ends, s."""
        return None if self.t0_s is None else (self.t0_s, self.until_s)

    def elapsed_time(self, batch: Batch) -> Floats:
        """Return the time (N,) s since the law began; 0 in rows that it does not reach.

        Raises:
            OptionError: nobody said when it began.

        """
        t = np.asarray(self.column(batch, "t"), dtype=np.float64)
        if self.t0_s is None:
            raise OptionError(f"{self.id} needs t0_s: give the time in s at which it began.", effect=self.id)
        return np.where(applicable_time_mask(t, self.t0_s, self.until_s), t - self.t0_s, 0.0)


def settled_share(elapsed: Floats, tau_s: float) -> Floats:
    """Return 1 − exp(−t/τ) (N,) of rows ``elapsed`` t s after the beginning; 0 before it."""
    return np.asarray(-np.expm1(-np.maximum(elapsed, 0.0) / tau_s))


def time_constants(span_s: float, shares: tuple[float, ...] = SHARES) -> tuple[float, ...]:
    """Return time constants s for rows over ``span_s``, in two digits, so that names of parameters stay short."""
    found = (float(f"{share * span_s:.2g}") for share in shares)
    return tuple(dict.fromkeys(tau if tau > 0.0 else 1.0 for tau in found))


def span_of_clock(t: Floats) -> tuple[float, float]:
    """Return the first and last time (s) of rows; of those on the shared clock alone where rows are on several."""
    shared = on_shared_clock(t)
    own = t[shared] if shared.any() else t
    return float(np.min(own)), float(np.max(own))


@dataclass(frozen=True)
class LawOfTemperature(Effect):
    """Something moves in proportion to T − T0; ``reference_c`` is T0, at which the geometry holds.

    Any T0 will do as long as all campaigns use the same one.
    """

    needs = frozenset({"temperature_c"})
    clock = "temperature_c"

    reference_c: float = option(20.0, "Temperature T0 at which the geometry holds, degrees Celsius.", above=-273.15)
    corrected: bool = option(
        True, "Whether a correction makes up for it; false where the base, the station or the air may be what moves."
    )

    def warmer(self, batch: Batch) -> Floats:
        """Return T − T0 (N,) K of the rows."""
        return np.asarray(self.column(batch, "temperature_c"), dtype=np.float64) - self.reference_c

    def warmer_now(self, form: RunTimeForm) -> float | None:
        """Return T − T0 in K of a moving arm; None where its temperature is not stated or this is not corrected."""
        return form.warmer_than(self.reference_c) if self.corrected else None


@dataclass(frozen=True)
class Step(Effect):
    """Something jumped between two rows.

    Rows before ``at_s``, on their clock, or before ``at_row`` where no time is known, have the old state; all others,
    and rows of other days that say neither, have the new one, which is that of the geometry. A gap search places it.
    """

    source = "Quandt 1958; Bai and Perron 1998: a linear model whose parameters change at an unknown row"
    glances = frozenset({"t", "row"})
    event = True
    clock = "t"
    separated_by = (Separator.ORDER,)

    at_s: float | None = option(None, "When it happened, s on the clock of the rows.")
    at_row: int | None = option(None, "First row after it, counted from 1 as measured.")

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Put it in the middle of the rows where nothing says when it happened."""
        if rows is None or not len(rows) or self.at_s is not None or self.at_row is not None:
            return self
        if rows.t is not None:
            return replace(self, at_s=float(np.median(rows.t)))
        return self if rows.row is None else replace(self, at_row=int(np.median(rows.row)))

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """When it happened, s; it holds for ever."""
        return None if self.at_s is None else (self.at_s, None)


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
