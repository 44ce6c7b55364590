"""The order in which rows were measured, and what a clock says of it: clocks run backwards, restart, or are missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kilter_core.errors import FindingDocument
from kilter_core.types import Bools, Floats, Ints

SINCE_1970_S = 1e8  # no campaign lasts three years: such a time is of the clock that all computers share
RESTARTS = 0.02  # share of rows at which the time falls, up to which the clock was set back; above, rows are sorted
PAUSE = 0.5  # of the usual time between poses, above which the arm may have left and come back: halfway to all of it
RESTING = 10  # rows at rest that say how far joint readings wander there: one in ten is beyond by chance
CARRIED_S = 43_200.0  # half a day: a law of the morning holds in the afternoon, not on the next day
LEFT = 0.8  # share of the long pauses that must show a motion before any of them counts as one


class Timed(Protocol):
    """Rows as a clock sees them: joints ``q (N, n)``, times ``t (N,)`` s and sessions (N,), None where nobody said them."""

    @property
    def q(self) -> Floats:
        """Joints."""
        ...

    @property
    def t(self) -> Floats | None:
        """Times."""
        ...

    @property
    def session(self) -> Ints | None:
        """Sessions."""
        ...

    def __len__(self) -> int: ...


def on_shared_clock(t: Floats | Ints) -> Bools:
    """Return which times count from 1970: those of all campaigns are one clock, others have a beginning of their own."""
    return np.asarray(t > SINCE_1970_S)


def applicable_time_mask(t: Floats, begin_s: float, end_s: float | None) -> Bools:
    """Return which times are on the clock of a law of time, and within half a day of the rows that it was fitted to."""
    same: Bools = on_shared_clock(t) == bool(on_shared_clock(np.array(begin_s)))
    return same if end_s is None else same & (t >= begin_s - CARRIED_S) & (t <= end_s + CARRIED_S)


@dataclass(frozen=True)
class Clock:
    """``order (N,)`` in which the rows were measured; ``fell`` the first row whose time is before the last one's.

    ``trusted`` says that times may be subtracted within a session.
    """

    order: Ints
    trusted: bool
    fell: int | None = None


def read_clock(rows: Timed) -> Clock:
    """Order of the rows by session and time; the order given where there is no clock, or one that was set back."""
    given = np.arange(len(rows), dtype=np.int64)
    if rows.t is None or len(rows) < 2:
        return Clock(given, rows.t is not None)
    session = np.zeros(len(rows), dtype=np.int64) if rows.session is None else rows.session
    falls = np.flatnonzero((np.diff(rows.t) < 0.0) & (np.diff(session) == 0)) + 1
    if not len(falls):
        return Clock(given, True)
    if len(falls) <= max(1.0, RESTARTS * len(rows)):
        return Clock(given, False, int(falls[0]))
    backwards = int(falls[0]) if bool(np.all(np.diff(rows.t)[np.diff(session) == 0] <= 0.0)) else None
    return Clock(np.lexsort((rows.t, session)).astype(np.int64), True, backwards)


def clock_warnings(rows: Timed) -> Iterator[FindingDocument]:
    """Say where the clock of the rows runs backwards, and what was done instead."""
    clock = read_clock(rows)
    if clock.fell is None:
        return
    done = "times are counted backwards" if clock.trusted else "the order of the rows replaces the time"
    yield FindingDocument.make(
        "clock_backwards",
        f"The clock runs backwards at row {clock.fell + 1}: {done}. Give every restart of the clock a session of "
        "its own, or upload the rows with one clock.",
        row=clock.fell,
    )


def came_back(rows: Timed, clock: Clock, condition: Ints) -> Bools:
    """Where (N - 1,), in the clock's order, the arm left a pose and came back to it with nothing measured in between.

    A pause alone proves nothing: the next shot may simply have come late. It counts when joint readings changed over
    nearly every long pause by more than they ever do at rest.
    """
    same = condition[1:] == condition[:-1]
    none = np.zeros(len(same), dtype=bool)
    if rows.t is None or not clock.trusted or same.all() or not same.any():
        return none
    pause = np.abs(np.diff(rows.t[clock.order]))
    long = same & (pause > PAUSE * np.median(pause[~same]))
    rest = same & ~long
    if rest.sum() < RESTING or not long.any():
        return none
    moved = np.max(np.abs(np.diff(rows.q[clock.order], axis=0)), axis=1)
    left = long & (moved > np.max(moved[rest]))
    return left if left.sum() >= LEFT * long.sum() else none
