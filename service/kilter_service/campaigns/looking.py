"""Rows to look at: those of a stored campaign, or of a file that is not stored yet.

Poses, visits and the noise between them: what repeats of a pose say before anything is fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import ObservationError
from kilter_files.ground.later import pa, pc
from kilter_service.campaigns import service, store
from kilter_service.campaigns.belonging import MIXED_UP, Judged
from kilter_service.ground.db import Database
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.columns import Column, read_columns
from kilter_service.ground.tables.reading import Names
from kilter_service.ground.wire import joint_scale
from kilter_service.robots import store as robots

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.types import Floats, Ints


@dataclass(frozen=True)
class Rows:
    """A table in the contract's columns, what its columns mean, the robot, and what held for all of its rows."""

    table: pa.Table
    columns: tuple[Column, ...]
    robot: Robot
    conditions: dict[str, Any]


def load_campaign_rows(database: Database, campaign_id: str) -> Rows:
    """Return the rows of a campaign.

    Raises:
        ServiceError: no such campaign, or parts of it are missing.
        ObservationError: nothing was uploaded yet.

    """
    with database.reading() as session:
        campaign = store.whole(session, campaign_id)
        robot = robots.core_robot(session, campaign.robot_id)
        table = store.table(session, campaign_id)
    columns = read_columns(table.column_names, [joint.kind for joint in robot.joints])
    return Rows(table, columns, robot, campaign.conditions)


def columns(database: Database, campaign_id: str) -> tuple[Column, ...]:
    """Return what the columns of a campaign mean, without reading its rows; none where nothing was uploaded yet."""
    with database.reading() as session:
        robot = robots.core_robot(session, store.whole(session, campaign_id).robot_id)
        uploads = store.uploads_of_campaign(session, campaign_id)
    return read_columns(uploads[0].columns, [joint.kind for joint in robot.joints]) if uploads else ()


def of_file(
    database: Database, robot: str, path: Path, media: str, conditions: dict[str, Any] | None = None
) -> tuple[Rows, str, Judged | None]:
    """Return the rows of a file, what an upload would refuse it for (empty: it would be taken), and whether they belong.

    The last is None where the upload was refused before that was asked. ``conditions`` are those of the campaign it would go
    to; without them cameras and boards are not known, and may have any name.

    Raises:
        ObservationError: columns that mean nothing, or cells that are not numbers.
        ServiceError: no such robot.

    """
    with database.reading() as session:
        core = robots.core_robot(session, robots.usable(session, robot).id)
    names = reading.column_names(path, media)
    columns = read_columns(names, [joint.kind for joint in core.joints])
    refusal, belong = "", None
    try:
        belong = Judged(None, service.checked_chunks(path, media, names, core, conditions)[1])
    except ObservationError as error:
        refusal, belong = error.message, Judged(error) if error.code in MIXED_UP else None
    table = pa.concat_tables(list(reading.tables(path, media, Names.from_conditions(conditions)))).select(names)
    return Rows(table, columns, core, conditions or {}), refusal, belong


def spans(database: Database, campaign_id: str) -> dict[int, tuple[float, float]]:
    """Return from where to where each joint (from 0) was measured, in deg or mm."""
    rows = load_campaign_rows(database, campaign_id)
    out = {}
    for column in rows.columns:
        if column.quantity == "q" and column.number is not None:
            ends = pc.min_max(rows.table.column(column.name)).as_py()
            scale = column.factor * joint_scale(rows.robot)[column.number]
            out[column.number] = ends["min"] * scale, ends["max"] * scale
    return out


FAR = 6.0  # robust standard deviations from the other rows of its pose: such a row is named
MAD = 1.4826  # median absolute deviation of normal noise to its standard deviation
Far = tuple["Ints", "Floats", "Floats"]  # rows, how far from the others of their pose (m), in robust deviations
FEWEST_REPEATS = 2  # rows of a pose from which some may be said to lie apart; of two it is not known which


@dataclass(frozen=True)
class Repeats:
    """How often poses were measured; noise is the standard deviation of a coordinate, m, None without repeats.

    Rows ``far`` from the others of their pose do not count as noise: by ``distance`` m, or robust ``sigmas``.
    ``poses`` counts distinct poses, ``visits`` runs of rows at one pose under the same conditions.
    """

    poses: int
    visits: int
    rows_per_pose: tuple[int, int]
    visits_per_pose: tuple[int, int]
    repeated: int
    within: float | None
    between: float | None
    freedom: int
    far: Ints
    distance: Floats
    sigmas: Floats


def repeats(pose: Ints, under: Ints, visit: Ints, points: Floats | None) -> Repeats:
    """Count what repeats there are.

    ``pose (N,)`` numbers the poses from 0, ``under (N,)`` what repeats must share beside them, ``visit (N,)`` the visits;
    ``points (N, 3)`` m, nan where nothing was seen.
    """
    first = np.unique(visit, return_index=True)[1]
    rows, visits = np.bincount(pose), np.bincount(pose[first])
    within = between = None
    freedom, far, distance, sigmas = 0, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    seen = np.zeros(len(pose), dtype=bool) if points is None else ~np.asarray(np.isnan(points).any(axis=1))
    if points is not None and seen.any():
        far, distance, sigmas = _find_pose_outliers(_compact(under[seen]), points[seen])
        far = np.flatnonzero(seen)[far]
        seen[far] = False
        within, _ = _scatter(visit[seen], points[seen])
        means, _ = _means(_compact(visit[seen]), points[seen])
        start = np.unique(visit[seen], return_index=True)[1]
        between, freedom = _scatter(under[seen][start], means)
        far, distance, sigmas = _with_other_conditions(pose, under, points, (far, distance, sigmas))
    return Repeats(
        len(rows),
        len(first),
        (int(rows.min()), int(rows.max())),
        (int(visits.min()), int(visits.max())),
        int((visits > 1).sum()),
        within,
        between,
        freedom,
        far,
        distance,
        sigmas,
    )


def _with_other_conditions(pose: Ints, under: Ints, points: Floats, named: Far) -> Far:
    """Add rows far from visits of their pose from other sides or under other loads, where most such visits agree better.

    Backlash and load part them: how far is usual is told by all poses that were visited so. Noise is not made of them.
    """
    first = np.unique(np.column_stack([pose, under]), axis=0)[:, 0]
    left = (np.bincount(first)[pose] > 1) & ~np.isnan(points).any(axis=1)
    left[named[0]] = False
    rows = np.flatnonzero(left)
    if not len(rows):
        return named
    far, distance, sigmas = _find_pose_outliers(_compact(pose[rows]), points[rows])
    found = [np.concatenate(pair) for pair in zip(named, (rows[far], distance, sigmas), strict=True)]
    order = np.argsort(found[0], kind="stable")
    return found[0][order].astype(np.int64), found[1][order], found[2][order]


def _compact(keys: Ints) -> Ints:
    return np.asarray(np.unique(keys, return_inverse=True)[1].reshape(-1).astype(np.int64))


def _means(group: Ints, points: Floats) -> tuple[Floats, Ints]:
    """Mean (G, 3) of each group that has rows, and the groups."""
    count = np.bincount(group)
    there = np.flatnonzero(count)
    sums = np.stack([np.bincount(group, weights=column) for column in points.T], axis=1)
    return sums[there] / count[there, None], there


def _scatter(group: Ints, points: Floats) -> tuple[float | None, int]:
    """Pooled standard deviation of a coordinate about the mean of its group, and its degrees of freedom."""
    group = _compact(group)
    means, _ = _means(group, points)
    freedom = len(points) - len(means)
    if freedom < 1:
        return None, 0
    left = points - means[group]
    return float(np.sqrt((left**2).sum() / (3 * freedom))), 3 * freedom


def _find_pose_outliers(group: Ints, points: Floats) -> Far:
    """Rows much farther from the middle of their pose than rows usually are, how far, and in what is usual."""
    count = np.bincount(group)
    judged = count[group] >= FEWEST_REPEATS
    if not judged.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    left = np.linalg.norm(points - _medians(group, points)[group], axis=1)
    size = left * np.sqrt(count / np.maximum(count - 1, 1))[group]  # few rows draw the middle to themselves
    usual = MAD * float(np.median(size[judged]))
    far = np.flatnonzero(judged & (size > FAR * usual) & (size > 0))
    sigmas = size[far] / usual if usual > 0.0 else np.full(len(far), np.inf)
    return far.astype(np.int64), np.where(count == 2, 2.0, 1.0)[group[far]] * left[far], sigmas


def _medians(group: Ints, points: Floats) -> Floats:
    """Median (G, 3) of each group, coordinate by coordinate."""
    out = np.empty((int(group.max()) + 1, 3))
    count = np.bincount(group)
    start = np.cumsum(count) - count
    for axis in range(3):
        order = np.lexsort((points[:, axis], group))
        ordered = points[order, axis]
        low, high = start + (count - 1) // 2, start + count // 2
        out[:, axis] = (ordered[low] + ordered[high]) / 2
    return out
