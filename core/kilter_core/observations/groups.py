"""Groups of rows, by motion or condition: what is left of values when the mean of each is taken out."""

from __future__ import annotations

import math

import numpy as np

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
