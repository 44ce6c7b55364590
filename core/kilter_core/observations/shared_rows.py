"""Rows that are in two sets of observations, recognised by what they hold: file, name, order, time and unit do not count."""

from __future__ import annotations

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.observations.motions import is_trajectory
from kilter_core.observations.rows import Observations
from kilter_core.types import Floats, Ints

SAME_ROW = 1e-7  # m or rad: rows closer than this in all that was measured are one row, whatever unit they came in
COINCIDENCE = 0.01  # share of the rows of a motion that may be the same: an arm at rest reads the same twice


def refuse_shared_rows(rows: Observations, others: Observations, use: str) -> None:
    """Refuse ``others`` for a ``use`` (validation, confirmation) where they hold rows of ``rows``, which they would judge.

    Raises:
        ObservationError: ``rows_shared``, with the first of them and the remedy.

    """
    shared = rows_beyond_chance(rows, others)
    if not len(shared):
        return
    raise ObservationError(
        f"{len(shared)} of {len(others)} rows for {use} are also rows of the job itself (the first is row {shared[0] + 1} "
        f"of the {use}). Rows cannot judge what was made from them: leave these rows out of one of the two, or measure "
        "others.",
        code="rows_shared",
    )


def rows_beyond_chance(rows: Observations, others: Observations) -> Ints:
    """Return indices of ``others`` that are rows of ``rows`` too; none where they are as few as an arm at rest gives."""
    shared = shared_rows(rows, others)
    free = int(COINCIDENCE * len(others)) if is_trajectory(others) else 0
    return shared if len(shared) > free else shared[:0]


def shared_rows(rows: Observations, others: Observations) -> Ints:
    """Return indices of ``others`` whose joints and measured values are all in a row of ``rows`` too; each content once.

    Compared are the columns that both measured: a copy without one of its columns is still a copy.
    """
    pairs = list(zip(_measured_columns(rows), _measured_columns(others), strict=True))
    both = [(one, two) for one, two in pairs if one is not None and two is not None]
    if rows.q.shape[1] != others.q.shape[1] or not both or any(a.shape[1] != b.shape[1] for a, b in both):
        return np.zeros(0, dtype=np.int64)
    known = {row.tobytes() for row in _lattice([rows.q, *(one for one, _ in both)])}
    first: dict[bytes, int] = {}
    for k, row in enumerate(_lattice([others.q, *(two for _, two in both)])):
        first.setdefault(row.tobytes(), k)
    return np.array(sorted(k for row, k in first.items() if row in known), dtype=np.int64)


def _measured_columns(rows: Observations) -> list[Floats | None]:
    """Measured values, each (N, c); the time is left out, because a copy may be shifted."""
    contacts = (rows.socket, rows.plane, rows.bar, rows.bar_length)
    values = (rows.position, rows.markers, rows.link_q, *contacts)
    return [None if v is None else np.asarray(v.reshape(len(rows), -1), dtype=np.float64) for v in values]


def _lattice(columns: list[Floats]) -> Ints:
    """Values (N, c) in steps of ``SAME_ROW``; what was not measured is a step of its own."""
    whole = np.nan_to_num(np.hstack(columns), nan=1e3)
    return np.ascontiguousarray(np.round(whole / SAME_ROW).astype(np.int64))
