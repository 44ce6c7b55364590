"""The correction a stream carries from cycle to cycle: it follows the answers, is held without one, and is released."""

from __future__ import annotations

import time
from collections.abc import Sequence
from operator import add, sub

from kilter_client.streaming.accepted_versions import InUse
from kilter_client.streaming.frames import Answer, Setpoint, Statistics

LEAST_PAUSE_S, MOST_PAUSE_S = 0.001, 0.1  # the corrector takes less for jitter
ROUNDING = 1e-9


class Carried:
    """Correction of one stream; ``delta`` is empty before the first answer.

    It changes no faster than the version in use states and the caller allows, whatever the answers say.
    """

    def __init__(
        self,
        in_use: InUse,
        statistics: Statistics,
        settled: bool,
        hold_cycles: int,
        release_s: float,
    ) -> None:
        self.delta: tuple[float, ...] = ()
        self._in_use, self._statistics = in_use, statistics
        self._settled = settled
        self._hold_cycles, self._release_s = hold_cycles, release_s
        self._misses = 0
        self._offset: tuple[float, ...] = ()
        self._fade_ns = 0

    def hold(self, wanted: tuple[float, ...], answer: Answer | None) -> Setpoint:
        """Use the last correction again, or, after too many cycles, release it."""
        status = answer.status if answer is not None else None
        self._misses += 1
        if self.delta and self._misses <= self._hold_cycles:
            self._statistics.held += 1
            return Setpoint(_sum(wanted, self.delta), source="held", wanted=wanted, status=status)
        if not self.delta or self._misses == self._hold_cycles + 1:
            self._begin_fade(self.delta or (0.0,) * len(wanted))
        self.delta = self._add_fading_offset((0.0,) * len(wanted))
        self._statistics.bypassed += 1
        return Setpoint(_sum(wanted, self.delta), source="bypass", wanted=wanted, status=status)

    def follow(self, wanted: tuple[float, ...], answer: Answer, trip: float, pause_s: float, moved: float) -> Setpoint:
        """Take a correction over; after a bypass it fades in from where the release had got to."""
        delta = tuple(map(sub, answer.q, wanted))
        if self._misses > self._hold_cycles and self.delta:
            self._begin_fade(tuple(map(sub, self.delta, delta)))
        self._misses = 0
        self.delta = self._limit_rate(self._add_fading_offset(delta), pause_s, moved)
        self._statistics.note(answer.flags, answer.left_nm)
        if self.delta == delta:  # as nearly always
            self._statistics.corrected += 1
            return Setpoint(
                answer.q,
                source="corrected",
                wanted=wanted,
                status="OK",
                flags=answer.flags,
                round_trip_s=trip,
                left_nm=answer.left_nm,
                lag=(0.0,) * len(wanted),
                lag_mm=0.0,
            )
        self._statistics.slowed += 1
        lag = tuple(map(sub, delta, self.delta))
        return Setpoint(
            _sum(wanted, self.delta),
            source="slowed",
            wanted=wanted,
            status="OK",
            flags=answer.flags,
            round_trip_s=trip,
            lag=lag,
            lag_mm=self._in_use.at_tool_mm(lag),
        )

    def follow_chunk(
        self, rows: Sequence[tuple[float, ...]], q: Sequence[float], steps_s: Sequence[float]
    ) -> tuple[tuple[float, ...], float]:
        """Take the corrections of a chunk over; ``rows`` begin with the setpoint before it.

        Returns all joints, and how far one of them lags at most.
        """
        out: list[float] = []
        self._misses, lag = 0, 0.0
        for k, (before, row, step_s) in enumerate(zip(rows[:-1], rows[1:], steps_s, strict=True)):
            n = len(row)
            delta = tuple(map(sub, q[k * n : (k + 1) * n], row))
            self.delta = self._limit_rate(delta, step_s, farthest(row, before))
            lag = max(lag, farthest(delta, self.delta))
            out += _sum(row, self.delta)
        self._offset = ()
        return tuple(out), lag

    def _limit_rate(self, delta: tuple[float, ...], pause_s: float, moved: float) -> tuple[float, ...]:
        """``delta``, or as much of the straight way to it as the correction may change by.

        All joints go the same share of their way: joint by joint, those that move little would arrive before those that
        move much, and between two corrections that both leave the tool in place the tool would move.
        """
        before = self.delta or (delta if self._settled else (0.0,) * len(delta))
        rates = self._in_use.rates
        pause_s, besides = min(max(pause_s, LEAST_PAUSE_S), MOST_PAUSE_S), self._in_use.motion_share * moved + ROUNDING
        changes = list(map(abs, map(sub, delta, before)))
        if max(changes) <= min(rates) * pause_s + besides:  # as nearly always
            return delta
        share = min((rate * pause_s + besides) / change for rate, change in zip(rates, changes, strict=True) if change)
        if share >= 1.0:
            return delta
        return tuple(old + share * (new - old) for new, old in zip(delta, before, strict=True))

    def _begin_fade(self, offset: tuple[float, ...]) -> None:
        """From here on ``offset`` is added to the correction and fades out."""
        self._offset, self._fade_ns = offset, time.monotonic_ns()

    def _add_fading_offset(self, delta: tuple[float, ...]) -> tuple[float, ...]:
        """``delta`` plus what is left of the offset."""
        if not self._offset:
            return delta
        left = 1.0 - (time.monotonic_ns() - self._fade_ns) * 1e-9 / self._release_s
        if left <= 0.0:
            self._offset = ()
            return delta
        return tuple(a + left * b for a, b in zip(delta, self._offset, strict=True))


def farthest(a: Sequence[float], b: Sequence[float]) -> float:
    """How far two setpoints differ in their largest joint."""
    distance: float = max(map(abs, map(sub, a, b)))
    return distance


def _sum(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(map(add, a, b))
