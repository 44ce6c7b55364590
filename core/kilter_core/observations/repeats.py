"""Repeats of a pose, and the step that joint readings are multiples of.

Rounded readings fall apart where a pose lies near the edge between two steps: 20 poses measured three times with noise of
a ten-thousandth of a degree became 47, and repeats of a pose sat on both sides of a split.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.types import Bools, Floats, Ints

NEAR = 1e-4  # rad or m (6 thousandths of a degree): readings of a pose come back nearer than that in every joint
WIDE = 3.0  # times that: rows that hang together over a wider span are a motion, whose rows are not repeats
STEP = 1e-5  # of the readings of a motion: rows within one are the same place


def readings(q: Floats) -> Ints:
    """Joint vectors (N, n) in whole steps."""
    return np.asarray(np.round(q / STEP).astype(np.int64))


def numbered_rows(keys: Ints) -> Ints:
    """Number the rows (N, n) in ascending order, equal ones with the same number.

    As ``np.unique`` along axis 0, which sorts whole rows without letting any other thread run: a second for 200 000 rows.
    """
    if not len(keys):
        return np.zeros(0, dtype=np.int64)
    order = np.lexsort(keys.T[::-1])
    new = np.ones(len(keys), dtype=bool)
    new[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    out = np.empty(len(keys), dtype=np.int64)
    out[order] = np.cumsum(new) - 1
    return out


def rounded_poses(q: Floats) -> Ints:
    """Number joint vectors (N, n) by their rounded readings, as versions were split by before poses had a distance."""
    return numbered_rows(readings(q))


def numbered_poses(q: Floats) -> Ints:
    """Number the poses of joint vectors (N, n): rows that lie within ``NEAR`` of each other share a number.

    Neighbours are linked, so no edge parts them. Links over more than ``WIDE`` times that are a fine trajectory: there
    only rows of the same step share a number. The numbers ascend with the smallest reading of each pose, whatever the
    order of the rows.
    """
    if not len(q):
        return np.zeros(0, dtype=np.int64)
    steps = rounded_poses(q)
    group = _group_near_rows(q)
    count = int(group.max()) + 1
    order = np.argsort(group, kind="stable")
    start = np.searchsorted(group[order], np.arange(count))
    ordered = q[order]
    span = (np.maximum.reduceat(ordered, start) - np.minimum.reduceat(ordered, start)).max(axis=1)
    first = np.minimum.reduceat(steps[order], start)
    key = np.where(span[group] > WIDE * NEAR, steps, first[group])
    return np.unique(key, return_inverse=True)[1].reshape(-1).astype(np.int64)


def group_means(values: Floats, group: Ints) -> Floats:
    """Mean (G, ...) of the rows (N, ...) of each group; what is NaN in all rows of a group is NaN in its mean.

    ``group (N,)`` numbers the groups from 0, and each has a row.
    """
    flat = values.reshape(len(values), -1)
    seen = ~np.isnan(flat)
    sums = np.zeros((int(group.max(initial=-1)) + 1, flat.shape[1]))
    hits = np.zeros_like(sums)
    np.add.at(sums, group, np.where(seen, flat, 0.0))
    np.add.at(hits, group, seen)
    mean = np.where(hits > 0, sums / np.where(hits > 0, hits, 1.0), np.nan)
    return np.asarray(mean.reshape(len(sums), *values.shape[1:]))


def _group_near_rows(q: Floats) -> Ints:
    """Components (N,) of the rows linked to their neighbours; rows of one cell of a grid are linked without a search."""
    cell = _number_equal_rows(np.floor(q / NEAR).astype(np.int64))
    count = np.bincount(cell)
    middle = np.stack([np.bincount(cell, weights=column) for column in q.T], axis=1) / count[:, None]
    # Rows that lie near each other lie near each other along any direction; a random one has no ties.
    along = np.random.default_rng(0).normal(size=q.shape[1])
    order = np.argsort(middle @ along, kind="stable")
    ordered = np.ascontiguousarray(middle[order])
    group = np.empty(len(count), dtype=np.int64)
    group[order] = _label_components(ordered, ordered @ along, NEAR, NEAR * float(np.abs(along).sum()))
    return np.asarray(group[cell])


def _label_components(points: Floats, along: Floats, near: float, window: float) -> Ints:
    """Number (N,) of the component of each point (N, n): neighbours are within ``near`` in every coordinate.

    ``along (N,)`` ascends, and neighbours differ in it by no more than ``window``.
    """
    columns = np.ascontiguousarray(points.T)
    first, linked, step = np.arange(len(points)), [np.empty((2, 0), dtype=np.int64)], 0
    while len(first):
        step += 1
        first = first[: np.searchsorted(first, len(points) - step)]
        first = first[along[first + step] - along[first] <= window]
        close = first
        for column in columns:
            close = close[np.abs(column[close + step] - column[close]) <= near]
        linked.append(np.stack([close, close + step]))
    one, other = np.concatenate(linked, axis=1)
    # Each root hooks onto the least that a point of its own is linked to, and each point onto its root, until no link is open.
    parent = np.arange(len(points))
    while len(one):
        below, above = np.sort(np.stack([parent[one], parent[other]]), axis=0)
        np.minimum.at(parent, above, below)
        while ((root := parent[parent]) != parent).any():
            parent = root
        still = parent[one] != parent[other]
        one, other = one[still], other[still]
    return np.asarray(np.unique(parent, return_inverse=True)[1].reshape(-1).astype(np.int64))


def _number_equal_rows(keys: Ints) -> Ints:
    """Number the rows (N, n), equal ones with the same number, in no order: one sort of a hash instead of a sort of rows."""
    odd = np.random.default_rng(1).integers(0, 2**62, keys.shape[1]) * 2 + 1
    with np.errstate(over="ignore"):
        return np.asarray(np.unique((keys * odd).sum(axis=1), return_inverse=True)[1].reshape(-1).astype(np.int64))


FEWEST_LEVELS = 12  # different readings of a joint that tell a step: fewer are poses that were typed in
# Different readings from which a step that nobody knows tells, as of an encoder of 10 000 lines: that all of them are even
# happens by chance once in 500 000.
FEWEST_OF_A_MULTIPLE = 20
EXACT = 0.02  # of a step, by which readings may be off it: what a file's own decimals leave
DECIMALS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)
DEGREE = np.pi / 180.0  # rad
MILLIMETRE = 0.001  # m
BITS = tuple(range(8, 21))  # of an encoder, per revolution
LEROBOT_TICKS = 4095.0  # to 360 degrees, by which LeRobot converts the 4096 ticks of a servo


def reading_steps(q: Floats, slides: Sequence[bool] | Bools) -> Floats:
    """Largest step (n,), rad or m, that all readings of each joint are multiples of, up to a constant; 0 where there is none.

    Joints of too few different readings have the step of the others where it fits them.
    """
    steps = np.array([_step(column, _common_step_sizes(bool(slid))) for column, slid in zip(q.T, slides, strict=True)])
    for j, slid in enumerate(slides):
        others = [s for k, s in enumerate(steps) if s > 0.0 and bool(slides[k]) == bool(slid)]
        if len(np.unique(q[:, j])) < FEWEST_LEVELS:
            fits = [s for s in others if len(np.unique(q[:, j])) > 1 and _fits(q[:, j], s)]
            steps[j] = max(fits, default=0.0)
    return steps


def _common_step_sizes(slides: bool) -> Floats:
    """Steps that controllers and encoders have, the largest first."""
    decimals = np.array(DECIMALS)
    if slides:
        return decimals * MILLIMETRE
    ticks = 2.0 * np.pi / np.array([*(2.0**bits for bits in BITS), LEROBOT_TICKS])
    return np.sort(np.concatenate([decimals * DEGREE, decimals * 1e-2, ticks]))[::-1]


def _step(column: Floats, known: Floats) -> float:
    levels = np.unique(column)
    if len(levels) < FEWEST_LEVELS:
        return 0.0
    step = next((float(step) for step in known if _fits(column, step)), 0.0)
    if step > 0.0 and len(levels) >= FEWEST_OF_A_MULTIPLE:
        step *= int(np.gcd.reduce(np.round((levels - levels[0]) / step).astype(np.int64)))
    return step


def _fits(column: Floats, step: float) -> bool:
    away = (column - column[0]) / step
    return bool(np.all(np.abs(away - np.round(away)) < EXACT))
