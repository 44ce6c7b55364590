"""Rows that are in two sets of observations, recognised by what they hold: file, name, order, time and unit do not count."""

from __future__ import annotations

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.observations.groups import is_trajectory
from kilter_core.observations.repeats import numbered_rows
from kilter_core.observations.rows import Observations
from kilter_core.types import Bools, Floats, Ints

SAME_ROW = 1e-7  # m or rad: rows closer than this in all that was measured are one row, whatever unit they came in
ROUNDED_JOINT = 1e-5  # rad or m: readings rounded to a thousandth of a degree, and a little more
ROUNDED_POINT = 6e-7  # m: coordinates rounded to a micrometre; two visits of a pose are farther apart by their noise
FEWEST_ROUNDED, SHARE_ROUNDED = 3, 0.05  # fewer near pairs than this are chance between visits of the same poses
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

    Compared are the columns that both measured: a copy without one of its columns is still a copy, and so are copies
    rounded to a micrometre and a thousandth of a degree, where they are more than chance makes of repeated poses.
    """
    pairs = list(zip(_measured_columns(rows), _measured_columns(others), strict=True))
    both = [(one, two) for one, two in pairs if one is not None and two is not None]
    if (
        not len(rows)
        or rows.q.shape[1] != others.q.shape[1]
        or not both
        or any(a.shape[1] != b.shape[1] for a, b in both)
    ):
        return np.zeros(0, dtype=np.int64)
    known = _without_gaps([rows.q, *(one for one, _ in both)])
    asked = _without_gaps([others.q, *(two for _, two in both)])
    known, first = known[_distinct(known)], _distinct(asked)
    exact = first[_is_near(known, asked[first], np.full(known.shape[1], SAME_ROW))]
    points = (rows.position, rows.markers)
    if all(v is None for v in points):
        return exact
    n = rows.q.shape[1]
    rounding = np.r_[np.full(n, ROUNDED_JOINT), np.full(known.shape[1] - n, ROUNDED_POINT)]
    rounded = first[_is_near(known, asked[first], rounding)]
    return rounded if len(rounded) > max(FEWEST_ROUNDED - 1, SHARE_ROUNDED * len(first)) else exact


def _is_near(known: Floats, asked: Floats, tolerance: Floats) -> Bools:
    """Which rows (M, c) lie within a tolerance (c,) of one of the known ones (N, c), in every column."""
    from scipy.spatial import cKDTree  # the API imports this module at its start, and seldom compares rows

    distance, _ = cKDTree(known / tolerance, balanced_tree=False).query(
        asked / tolerance, p=np.inf, distance_upper_bound=1.0
    )
    return np.asarray(np.isfinite(distance))


def _measured_columns(rows: Observations) -> list[Floats | None]:
    """Measured values, each (N, c); the time is left out, because a copy may be shifted."""
    contacts = (rows.socket, rows.plane, rows.bar, rows.bar_length)
    values = (rows.position, rows.markers, rows.link_q, *contacts)
    return [None if v is None else np.asarray(v.reshape(len(rows), -1), dtype=np.float64) for v in values]


def _without_gaps(columns: list[Floats]) -> Floats:
    """Values (N, c), in which what was not measured has a value of its own."""
    return np.nan_to_num(np.hstack(columns), nan=1e3)


def _distinct(values: Floats) -> Ints:
    """Return the first row of each content, ascending."""
    _, first = np.unique(numbered_rows(np.round(values / SAME_ROW).astype(np.int64)), return_index=True)
    return np.sort(first)


COPY = 1e-9  # m or rad: no instrument repeats itself so exactly
COARSE = 0.05  # share of equal coordinates between repeats from which the instrument rounds: equal rows prove nothing


def identical_repeats(rows: Observations) -> Bools:
    """Rows (N,) that repeat all that was measured in an earlier row of the same pose and conditions, to the last digit."""
    parts = [
        v.reshape(len(rows), -1) for v in (rows.position, rows.rotation, rows.markers, rows.link_q) if v is not None
    ]
    if not parts:
        return np.zeros(len(rows), dtype=bool)
    lattice = np.round(np.nan_to_num(np.hstack(parts), nan=-1.0) / COPY)
    condition = rows.conditions()
    order = np.lexsort((np.arange(len(rows)), condition))
    pairs = condition[order][1:] == condition[order][:-1]
    equal = lattice[order][1:][pairs] == lattice[order][:-1][pairs]
    others = equal[~equal.all(axis=1)]
    if len(others) and float(np.mean(others)) > COARSE:
        return np.zeros(len(rows), dtype=bool)
    first = np.unique(np.hstack([condition[:, None], lattice]), axis=0, return_index=True)[1]
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    return again
