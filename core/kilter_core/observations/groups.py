"""Groups of rows, and from which side each joint came to a row."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.observations.clock import read_clock
from kilter_core.observations.rows import Observations
from kilter_core.types import Bools, Floats, Ints


def subtract_group_means(values: Floats, group: Ints, kept: Bools | None = None) -> Floats:
    """Values (V, ...) less the mean of their group (V,), taken over those ``kept (V,)``, all of them when None."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    rows, groups = (flat, group) if kept is None else (flat[kept], group[kept])
    size = int(group.max(initial=-1)) + 1
    count = np.maximum(np.bincount(groups, minlength=size), 1)
    means = np.stack([np.bincount(groups, c, minlength=size) for c in rows.T], axis=1) / count[:, None]
    return np.asarray((flat - means[group]).reshape(values.shape))


def unbiased_deviations(values: Floats, group: Ints, kept: Bools) -> tuple[Floats, Floats]:
    """Values (V, m) less the mean that those ``kept (V,)`` have in their group, and the factor (V, 1) they grow by.

    A mean of n values is pulled towards each of them: deviations times the factor have the variance of the values.
    """
    count = np.bincount(group[kept], minlength=int(group.max(initial=-1)) + 1)
    factor = np.sqrt(np.maximum(count, 2) / np.maximum(count - 1, 1))[group][:, None]
    return subtract_group_means(values, group, kept) * factor, factor


def evenly(count: int, most: int) -> Ints:
    """Places of at most so many out of ``count``, shape (min(count, most),), evenly spread from the first to the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)


FEWEST_ROWS = 300
SMOOTH = 0.02  # step from row to row over the whole spread, below which rows are one motion
UNEXPLAINED = 0.25  # share of the squared steps that speeds may leave unexplained


def is_trajectory(rows: Observations) -> bool:
    """Whether the rows are samples of motions: many, timed, unrepeated, and each follows from the one before.

    With speeds, those must explain the steps. Without, steps must be small: poses of a fine grid look much the same.
    """
    if len(rows) < FEWEST_ROWS or rows.t is None or rows.pose_id is not None:
        return False
    step = np.diff(rows.q, axis=0)
    if rows.qd is not None:
        on = np.diff(segments(rows)) == 0
        foreseen = 0.5 * (rows.qd[1:] + rows.qd[:-1]) * np.diff(rows.t)[:, None]
        size = float(np.sum(step[on] ** 2))
        return size > 0.0 and float(np.sum((step - foreseen)[on] ** 2)) < UNEXPLAINED * size
    spread = float(np.linalg.norm(np.std(rows.q, axis=0)))
    return bool(np.median(np.linalg.norm(step, axis=1)) < SMOOTH * spread)


def segments(rows: Observations) -> Ints:
    """Number the motions (V,): a new one wherever the session changes or time starts again."""
    new = np.zeros(len(rows), dtype=bool)
    if rows.session is not None:
        new[1:] |= rows.session[1:] != rows.session[:-1]
    if rows.t is not None:
        new[1:] |= rows.t[1:] < rows.t[:-1]
    return np.asarray(np.cumsum(new), dtype=np.int64)


def is_log(rows: Observations) -> bool:
    """Whether torques are all that the rows measured beside the joints."""
    tool = (rows.position, rows.markers, rows.socket, rows.plane, rows.bar, rows.pixels)
    measured = (*tool, rows.link_q, rows.tilt)
    return rows.tau is not None and all(one is None for one in measured)


REST = 3e-4  # rad or m: readings of an arm at rest come back nearer than that
CLEAR = 5e-3  # rad or m (0.3 deg): a motion that crosses the backlash of any industrial gear


def with_directions(rows: Observations) -> Observations:
    """Return rows with the direction of the last motion of each joint, as stated, else by their order.

    Samples of a motion stay as they are: the arm did not stop there.
    """
    if rows.direction is not None or len(rows) < 2 or is_trajectory(rows):
        return rows
    order = read_clock(rows).order
    found = np.empty_like(rows.q)
    found[order] = last_motion(rows.q[order], _new_session(rows, order), _same_pose(rows, order))
    return replace(rows, direction=found, directions_derived=True) if found.any() else rows


def last_motion(q: Floats, starts: Bools | None = None, rests: Bools | None = None) -> Floats:
    """Return the direction {-1, 0, 1} of the last motion of each joint (N, n), for rows in the order of their measurement.

    0 before the first motion and after one too small to tell: where the joint then sits in its backlash is not known.
    ``starts (N,)`` marks rows before which the arm may have been anywhere, ``rests (N,)`` those of the pose before.
    """
    step = np.diff(q, axis=0, prepend=q[:1])
    size = np.abs(step)
    kept = size <= REST
    if rests is not None:
        kept = kept | rests[:, None]
    sign = np.where(size > CLEAR, np.sign(step), 0.0)
    begin = np.zeros(len(q), dtype=bool) if starts is None else starts.copy()
    begin[:1] = True
    sign, kept = np.where(begin[:, None], 0.0, sign), kept & ~begin[:, None]
    since = np.maximum.accumulate(np.where(kept, 0, np.arange(len(q))[:, None]), axis=0)
    return np.take_along_axis(sign, since, axis=0)


def _new_session(rows: Observations, order: Ints) -> Bools:
    """Which rows (N,), in order, begin a session, or follow rows that are not there."""
    new = np.zeros(len(order), dtype=bool)
    for column in (rows.session, rows.setup):
        if column is not None:
            new[1:] |= np.diff(column[order]) != 0
    if rows.row is not None:
        new[1:] |= np.diff(rows.row[order]) != 1
    return new


def _same_pose(rows: Observations, order: Ints) -> Bools:
    """Which rows (N,), in order, are of the pose of the row before."""
    pose = rows.pose_groups()[order]
    same = np.zeros(len(order), dtype=bool)
    same[1:] = pose[1:] == pose[:-1]
    return same


def with_neutral_conditions(rows: Observations, needs: frozenset[str]) -> Observations:
    """Rows (N,) with constants for what effects need and a pose cannot choose: at rest, 20 deg C, level, one session."""
    n = len(rows)
    made: dict[str, Any] = {
        "qd": np.zeros_like(rows.q),
        "qdd": np.zeros_like(rows.q),
        "t": np.zeros(n),
        "temperature_c": np.full(n, 20.0),
        "base_tilt_x": np.zeros(n),
        "base_tilt_y": np.zeros(n),
        "payload_kg": np.zeros(n),
        "session": np.zeros(n, dtype=np.int64),
        "direction": np.zeros_like(rows.q),
    }
    return replace(rows, **{name: made[name] for name in needs if name in made and getattr(rows, name) is None})
