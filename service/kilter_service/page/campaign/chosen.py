"""Rows that somebody chose in a table, a plot or the picture: what is known of each, as numbers and as a file."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError
from kilter_files.ground.later import pa
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.facts import campaign_cache_key
from kilter_service.contract.campaigns import Campaign
from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables.reading import CSV
from kilter_service.ground.tables.writing import write_table
from kilter_service.ground.wire import joint_scale, joint_units
from kilter_service.page.campaign import service
from kilter_service.page.campaign.series import KEPT
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.predictions import places
from kilter_service.versions.predictions.paired import error_lengths, residuals

if TYPE_CHECKING:
    from kilter_core.types import Floats


MOST_LISTED = 200  # rows of a list; the file has all that were chosen
LEFT = ("dx_mm", "dy_mm", "dz_mm", "residual_sigma")
SIGMA, JOINT = (
    "residual_sigma",
    "joint:",
)  # columns that no file has: of the version, and its error as motions of joints


@dataclass(frozen=True)
class Row:
    """A row: its place in the campaign and in its file, joints as read, and what the version leaves of it (None: unknown)."""

    row: int
    file: int
    file_row: int
    joints: Sequence[str]
    error_mm: float | None
    sigma: float | None


@dataclass(frozen=True)
class Chosen:
    """Rows of a campaign, at most so many as a list has; ``count`` of them were chosen. ``version`` judges them."""

    campaign: Campaign
    version: str
    version_name: str
    joints: Sequence[str]
    units: Sequence[str]
    rows: Sequence[Row]
    count: int
    ranges: str


def read(text: str) -> list[int]:
    """Read rows as ``1-3,7``, from 1, in order and each once.

    Raises:
        ServiceError: it is not that.

    """
    found: set[int] = set()
    for part in filter(None, text.split(",")):
        low, _, high = part.partition("-")
        if not (low.isdigit() and (high or low).isdigit()):
            raise ServiceError(
                f"{part[:40]!r} cannot be read as rows: write them as 1-3,7.", code="payload_invalid", field="rows"
            )
        first, last = int(low), int(high or low)
        if last - first > 10_000_000:
            raise ServiceError("More than ten million rows: choose fewer.", code="payload_invalid", field="rows")
        found.update(range(first, last + 1))
    return sorted(found)


def ranges(rows: Sequence[int]) -> str:
    """Write rows, in order, as ``1-3,7``."""
    out: list[tuple[int, int]] = []
    for row in rows:
        out[-1:] = [(out[-1][0], row)] if out and row == out[-1][1] + 1 else [*out[-1:], (row, row)]
    return ",".join(f"{low}-{high}" if high > low else f"{low}" for low, high in out)


def chosen(database: Database, campaign_id: str, text: str, version: str) -> Chosen:
    """Return what is known of rows; ``version`` judges them, the active one where it is empty.

    Raises:
        ServiceError: no such campaign, row or version.

    """
    campaign, rows = named_rows(database, campaign_id, text)
    judge = _judge(database, campaign, version)
    arm, shown = robots.arm(database, campaign.robot), rows[:MOST_LISTED]
    columns = service.joint_columns(database, campaign)
    left = _residuals_by_column(database, campaign, judge)
    starts = [0, *accumulate(upload.rows for upload in campaign.uploads)]
    found = []
    for row in shown:
        file = bisect_right(starts[:-1], row - 1)
        joints = [f"{column[row - 1]:.2f}" for column in columns]
        error, sigma = (_value_or_none(left.get(name), row) for name in ("error_mm", SIGMA))
        found.append(Row(row, file, row - starts[file - 1], joints, error, sigma))
    name = display_name(versions.get(database, judge)) if judge and left else ""
    return Chosen(
        campaign,
        judge if left else "",
        name,
        [joint.name for joint in arm.joints],
        joint_units(arm),
        found,
        len(rows),
        ranges(rows),
    )


def named_rows(database: Database, campaign_id: str, text: str) -> tuple[Campaign, list[int]]:
    """Return a campaign and rows of it, in order.

    Raises:
        ServiceError: no such campaign or row, or none was named.

    """
    campaign, rows = campaigns.get(database, campaign_id), read(text)
    if not rows or rows[0] < 1 or rows[-1] > campaign.rows:
        wrong = next((row for row in rows if not 1 <= row <= campaign.rows), None)
        said = "No row is chosen" if wrong is None else f"{campaign.name} has no row {wrong}"
        raise ServiceError(
            f"{said}: choose rows from 1 to {campaign.rows}.", code="payload_invalid", campaign=campaign_id
        )
    return campaign, rows


def _judge(database: Database, campaign: Campaign, version: str) -> str:
    """The version that judges rows; empty: none is named, and none is active."""
    return version or robots.get(database, campaign.robot).active_version or ""


def _residuals_by_column(database: Database, campaign: Campaign, version: str) -> dict[str, Floats]:
    """What a version leaves of each row, by column; nothing where that cannot be said."""
    if not version:
        return {}
    table: dict[str, Any] = {}

    def column(name: str) -> Floats:
        if not table:
            found = residuals(database, version, [campaign.id])
            table.update(found, error_mm=error_lengths(found))
        return np.asarray(table[name], dtype=np.float64)

    try:
        return {
            name: KEPT.get((version, *campaign_cache_key(campaign), name), lambda name=name: column(name))  # type: ignore[misc]
            for name in (*LEFT, "error_mm")
        }
    except CoreError:  # another robot's version, or nothing was measured at the tool: rows are shown without errors
        return {}


def _value_or_none(column: Floats | None, row: int) -> float | None:
    value = float("nan") if column is None else float(column[row - 1])
    return value if value == value else None


def as_csv(database: Database, campaign_id: str, text: str, version: str) -> bytes:
    """Return rows with all their columns as they were measured, and what the version leaves of them."""
    campaign, rows = named_rows(database, campaign_id, text)
    left = _residuals_by_column(database, campaign, _judge(database, campaign, version))
    places = np.array(rows) - 1
    table = looking.load_campaign_rows(database, campaign.id).table.take(places)
    table = table.add_column(0, "row", pa.array(rows)).add_column(0, "campaign", pa.array([campaign.id] * len(rows)))
    for name in LEFT if left else ():
        found = left[name][places]
        table = table.append_column(name, pa.array(found, pa.float64(), mask=np.isnan(found)))
    return write_table(table, CSV)


def values(database: Database, campaign_id: str, version: str, column: str) -> dict[str, Any]:
    """Return a column at the rows that the picture shows: of the campaign, :data:`SIGMA`, or of ``joint:NAME``.

    Raises:
        ServiceError: no such campaign, version or joint.
        ObservationError: no such column.

    """
    campaign, found = campaigns.get(database, campaign_id), places.places(database, version, campaign_id)
    unit = ""
    if column == SIGMA:
        left = _residuals_by_column(database, campaign, version)
        shown = left[SIGMA][found.row - 1] if left else None
    elif column.startswith(JOINT):
        shown, unit = _of_joint(database, campaign, version, column.removeprefix(JOINT))
    else:
        shown, unit = (
            service.of_column(database, campaign, column)[found.row - 1],
            service.unit(database, campaign, column),
        )
    numbers = [] if shown is None else [None if v != v else round(float(v), 6) for v in shown]
    return {"column": column, "unit": unit, "values": numbers}


def _of_joint(database: Database, campaign: Campaign, version: str, name: str) -> tuple[Floats, str]:
    """The error as a motion of one joint, in degrees or mm."""
    arm = robots.arm(database, campaign.robot)
    names = [joint.name for joint in arm.joints]
    if name not in names:
        raise ServiceError(
            f"{campaign.robot} has no joint {name[:64]!r}: it has {', '.join(names)}.", code="option_invalid"
        )
    place = names.index(name)
    motion = places.joint_errors(database, version, campaign.id)[:, place]
    return motion * joint_scale(arm)[place], joint_units(arm)[place]
