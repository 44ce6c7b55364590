"""Rows of a trajectory through the program of the stream, so that both give the same numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError
from kilter_service.corrector.frames import Status

if TYPE_CHECKING:
    from kilter_core.correct.program import CorrectionOptions, CorrectionProgram
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations

Floats = NDArray[np.float64]

STILL = 1e-9  # rad or m: smaller steps are no motion
MOST_CONDITIONS = 200
SLICE = 64


@dataclass(frozen=True)
class Corrected:
    """``q (N, n)`` rad or m and ``error_removed (N, 3)`` m, NaN where ``status (N,)`` is not OK; what is left out, by id."""

    q: Floats
    error_removed: Floats
    status: NDArray[np.int64]
    not_corrected: tuple[str, ...]


def corrected(calibration: Calibration, rows: Observations, options: CorrectionOptions) -> Corrected:
    """Correct rows: with times as a stream that rests at the first of them, without times each by itself.

    Rows that name directions are also taken by themselves, for a stream finds out directions from its own past.

    Raises:
        ObservationError: times that go back, or load and temperature that change too often.

    """
    runs = list(_runs(calibration, rows, options))
    by_time = rows.t is not None and rows.direction is None
    q, removed, status = _followed(rows, runs) if by_time else _by_themselves(rows, runs)
    refused = status != Status.OK
    q[refused], removed[refused] = np.nan, np.nan
    return Corrected(q, removed, status, tuple(sorted({name for _, program in runs for name in program.unsupported})))


def _runs(
    calibration: Calibration, rows: Observations, options: CorrectionOptions
) -> Iterator[tuple[slice, CorrectionProgram]]:
    """Stretches under one load and temperature, each with its program."""
    from kilter_core.correct.program import compile_program

    conditions = np.column_stack(
        [
            np.zeros(len(rows)) if rows.payload_kg is None else rows.payload_kg,
            np.zeros((len(rows), 3)) if rows.payload_com is None else rows.payload_com,
            np.full(len(rows), math.nan) if rows.temperature_c is None else rows.temperature_c,
        ]
    )
    same = (conditions[1:] == conditions[:-1]) | (np.isnan(conditions[1:]) & np.isnan(conditions[:-1]))
    starts = [0, *(np.flatnonzero(~same.all(axis=1)) + 1).tolist()]
    if len(starts) > MOST_CONDITIONS:
        raise ObservationError(
            f"Payload or temperature changes {len(starts) - 1} times: a trajectory may do so {MOST_CONDITIONS - 1} times. "
            "Round them, or split the trajectory."
        )
    for start, end in zip(starts, [*starts[1:], len(rows)], strict=True):
        payload, x, y, z, temperature = conditions[start].tolist()
        here = replace(options, payload_kg=payload, payload_com=(x, y, z))
        if not math.isnan(temperature):
            here = replace(here, temperature_c=temperature)
        yield slice(start, end), compile_program(calibration, here)


def _by_themselves(rows: Observations, runs: list[tuple[slice, Any]]) -> tuple[Floats, Floats, NDArray[np.int64]]:
    direction = rows.direction if rows.direction is not None else last_motion(rows.q)
    parts = [
        program.correct_rows(
            rows.q[where],
            qd=None if rows.qd is None else rows.qd[where],
            qdd=None if rows.qdd is None else rows.qdd[where],
            direction=direction[where],
        )
        for where, program in runs
    ]
    return (
        np.concatenate([part.q for part in parts]),
        np.concatenate([part.error_removed for part in parts]),
        np.concatenate([part.status for part in parts]),
    )


def _followed(rows: Observations, runs: list[tuple[slice, Any]]) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Every row after the one before. A refused row leaves no trace: the next goes on from the last that was answered."""
    from kilter_core.correct.program import Track

    t = np.asarray(rows.t)
    back = np.flatnonzero(~(np.diff(t) >= 0))
    if len(back):
        row = int(back[0]) + 2
        raise ObservationError(f"Row {row}, column 't_s': the time goes back.", row=row, column="t_s")
    given = [rows.q]
    for part in (rows.qd, rows.qdd):
        if part is None:
            break
        given.append(part)
    x = np.ascontiguousarray(np.hstack(given))
    q, removed = np.empty(rows.q.shape), np.empty((len(rows), 3))
    status = np.empty(len(rows), dtype=np.int64)
    track = Track(runs[0][1], settled=True)
    answered = t[0]
    for where, program in runs:
        if program is not track.program:
            track.change(program)
        at, size = where.start, SLICE
        while at < where.stop:
            end = min(at + size, where.stop)
            steps = np.diff(t[at:end], prepend=answered)
            done, out, info, verdict = track.follow(x[at:end], len(given), steps)
            taken = slice(at, at + done + (done < end - at))  # the refused row as well
            count = taken.stop - at
            q[taken], removed[taken], status[taken] = out[:count], -info[:count, 4:7], verdict[:count]
            if done:
                answered = t[at + done - 1]
            # Where many are refused the kernel is called often: small slices keep what it leaves out small.
            size = 4 * size if done == end - at else SLICE
            at = taken.stop
    return q, removed, status


def last_motion(q: Floats) -> Floats:
    """Return the direction {-1, 0, 1} in which each joint last moved, (N, n), for rows that follow one another."""
    step = np.diff(q, axis=0, prepend=q[:1])
    sign = np.where(np.abs(step) > STILL, np.sign(step), 0.0)
    since = np.maximum.accumulate(np.where(sign != 0, np.arange(len(q))[:, None], 0), axis=0)
    return np.take_along_axis(sign, since, axis=0)
