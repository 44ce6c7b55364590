"""Rows to look at: those of a stored campaign, or of a file that is not stored yet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
