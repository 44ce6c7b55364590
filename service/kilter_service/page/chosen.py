"""Rows of a campaign: its columns as lines to draw, and rows that somebody chose, as numbers and as a file."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import partial
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import CoreError, ObservationError
from kilter_files.ground.later import pa
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.facts import campaign_cache_key, display_unit_and_factor
from kilter_service.contract.campaigns import Campaign
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import Recent
from kilter_service.ground.naming import display_name
from kilter_service.ground.tables.reading import CSV
from kilter_service.ground.tables.writing import write_table
from kilter_service.ground.wire import joint_scale, joint_units
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.predictions import places
from kilter_service.versions.predictions.differences import error_lengths, residuals

if TYPE_CHECKING:
    from kilter_core.types import Floats
    from kilter_service.campaigns.looking import Rows
    from kilter_service.ground.tables.columns import Column


KEPT_BYTES = 96 << 20  # a dozen columns of a million rows
LEAST, MOST = 50, 4000  # pixels


def thin_series(
    values: Floats, first: int, last: int, width: int, keep: Sequence[int] = ()
) -> tuple[list[int], list[float | None]]:
    """Return rows (from 1) and values to draw of rows ``first`` to ``last``: of each pixel the least and the greatest.

    Where there are fewer rows than two to a pixel, all of them. Rows to ``keep`` are always among them.
    """
    first, last = max(1, first), min(len(values), last)
    part = values[first - 1 : last]
    if len(part) <= 2 * width:
        return list(range(first, first + len(part))), [None if np.isnan(v) else float(v) for v in part]
    edges = np.linspace(0, len(part), width + 1).astype(np.int64)
    starts = edges[:-1]
    low = _places(np.where(np.isnan(part), np.inf, part), starts)
    high = _places(np.where(np.isnan(part), np.inf, -part), starts)
    kept = np.array([row - first for row in keep if first <= row <= last], dtype=np.int64)
    chosen = np.unique(np.concatenate([low, high, kept]))
    return (chosen + first).tolist(), [None if np.isnan(v) else float(v) for v in part[chosen]]


def _places(values: Floats, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The place of the least value between one start and the next."""
    least = np.minimum.reduceat(values, starts)
    lengths = np.diff(np.append(starts, len(values)))
    hits = np.flatnonzero(values == np.repeat(least, lengths))
    owner = np.searchsorted(starts, hits, side="right") - 1
    return hits[np.unique(owner, return_index=True)[1]]


KEPT = Recent["Floats"](KEPT_BYTES, lambda column: column.nbytes)  # of whichever campaigns


def series(
    database: Database, campaign_id: str, column: str, first: int, last: int, width: int, keep: Sequence[int]
) -> dict[str, Any]:
    """Return a column as points to draw, in the unit that people read.

    Raises:
        ObservationError: the campaign has no such column.

    """
    values = of_column(database, campaigns.get(database, campaign_id), column)
    rows, shown = thin_series(values, first, last if last > 0 else len(values), min(max(width, LEAST), MOST), keep)
    return {"column": column, "rows": len(values), "x": rows, "y": shown}


def of_column(database: Database, campaign: Campaign, name: str) -> NDArray[np.float64]:
    """Return a column of a campaign, row by row, in the unit that people read.

    Raises:
        ObservationError: the campaign has no such column.

    """
    names = campaign.uploads[0].columns if campaign.uploads else []
    if name not in names:
        raise ObservationError(
            f"Campaign {campaign.id} has no column {name[:64]!r}: it has {', '.join(names[:20]) or 'none'}.",
            column=name[:64],
        )
    return KEPT.get((*campaign_cache_key(campaign), name), lambda: _column(database, campaign, name))


def _unit(database: Database, campaign: Campaign, name: str) -> str:
    return next(display_unit_and_factor(one)[0] for one in looking.columns(database, campaign.id) if one.name == name)


def joint_columns(database: Database, campaign: Campaign) -> list[NDArray[np.float64]]:
    """Return the readings of the joints in their order, each row by row, in degrees or mm."""
    found = [one for one in looking.columns(database, campaign.id) if one.quantity == "q" and one.number is not None]
    return [of_column(database, campaign, one.name) for one in sorted(found, key=lambda one: one.number or 0)]


def _column(database: Database, campaign: Campaign, name: str) -> NDArray[np.float64]:
    """Read a column, and keep the others too: reading one of them takes as long as reading all."""
    rows = looking.load_campaign_rows(database, campaign.id)
    keep_columns(campaign, rows)
    return _values(rows, next(column for column in rows.columns if column.name == name))


def keep_columns(campaign: Campaign, rows: Rows) -> None:
    """Keep all columns of rows that were read."""
    for column in rows.columns:
        KEPT.get((*campaign_cache_key(campaign), column.name), partial(_values, rows, column))


def _values(rows: Rows, column: Column) -> NDArray[np.float64]:
    cells = rows.table.column(column.name).to_numpy(zero_copy_only=False)
    return np.asarray(cells * display_unit_and_factor(column)[1], dtype=np.float64)


MOST_LISTED = 200  # rows of a list; the file has all that were chosen
LEFT = ("dx_mm", "dy_mm", "dz_mm", "residual_sigma")
SIGMA, JOINT = "residual_sigma", "joint:"  # columns that no file has: of the version, and its error by joints


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


def chosen(database: Database, campaign_id: str, text: str, version: str) -> dict[str, Any]:
    """Return what is known of rows, at most so many as a list has; ``version`` judges them, the active one where it is empty.

    Raises:
        ServiceError: no such campaign, row or version.

    """
    campaign, rows = named_rows(database, campaign_id, text)
    judge = _judge(database, campaign, version)
    arm, columns = robots.arm(database, campaign.robot), joint_columns(database, campaign)
    left = _residuals_by_column(database, campaign, judge)
    starts = [0, *accumulate(upload.rows for upload in campaign.uploads)]
    found = []
    for row in rows[:MOST_LISTED]:
        file = bisect_right(starts[:-1], row - 1)
        known = {
            name: _value_or_none(left.get(column), row) for name, column in (("error_mm", "error_mm"), ("sigma", SIGMA))
        }
        joints = [f"{column[row - 1]:.2f}" for column in columns]
        found.append({"row": row, "file": file, "file_row": row - starts[file - 1], "joints": joints, **known})
    return {
        "campaign": campaign,
        "version": judge if left else "",
        "version_name": display_name(versions.get(database, judge)) if judge and left else "",
        "joints": [joint.name for joint in arm.joints],
        "units": joint_units(arm),
        "rows": found,
        "count": len(rows),
        "ranges": ranges(rows),
    }


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
        shown, unit = of_column(database, campaign, column)[found.row - 1], _unit(database, campaign, column)
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
