"""What the views of campaigns show, by the service functions of the features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError, ObservationError
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.facts import cached_campaign_facts, campaign_cache_key, display_unit_and_factor
from kilter_service.campaigns.suspicious import service as suspicious
from kilter_service.contract.campaigns import Campaign, SuspiciousRows
from kilter_service.contract.drift import Repair
from kilter_service.contract.versions import Version
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.page.campaign.series import KEPT, LEAST, MOST, thin_series
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.page.shared.measured import Seen, describe_facts
from kilter_service.robots.repairs import service as repairs
from kilter_service.versions import service as versions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from kilter_service.campaigns.looking import Rows
    from kilter_service.ground.tables.columns import Column


@dataclass(frozen=True)
class Shown:
    """A campaign, its rows (None: it has none, ``why`` says why), the versions made with it, and rows that look wrong."""

    campaign: Campaign
    seen: Seen | None
    why: str
    made: list[tuple[Version, str]]
    suspicious: SuspiciousRows
    columns: list[tuple[str, str]]
    noted: list[Repair]


def list_campaigns(database: Database, robot: str, with_retired: bool, asked: Asked) -> Part[Campaign]:
    """Return the campaigns of a robot that the address asks for, newest first."""
    return select_page(
        campaigns.list_campaigns(database, robot, Page(), False, with_retired).campaigns[::-1],
        asked,
        lambda one: f"{one.name} {one.device} {one.instrument or ''} {one.notes} {one.id}",
        {
            "name": lambda one: one.name,
            "device": lambda one: one.device or None,
            "rows": lambda one: one.rows,
            "stored": lambda one: one.created_at,
        },
        {"role": lambda one: one.role},
        "-stored",
    )


def load_campaign_view(database: Database, campaign_id: str) -> Shown:
    """Return all that is shown of a campaign."""
    campaign = campaigns.get(database, campaign_id)
    found, why = None, ""
    try:
        # Whoever looks at the page looks at its columns next.
        found = describe_facts(
            cached_campaign_facts(database, campaign, lambda rows: _keep(campaign, rows)), campaign=campaign.id
        )
    except CoreError as error:
        why = error.message
    used = [
        (version, use)
        for version in versions.versions_from_campaign(database, campaign.id)
        for use in _uses(version, campaign.id)
    ]
    columns = (
        [] if found is None else [(one[0], f"{one[1]}, {one[2]}" if one[2] != "–" else one[1]) for one in found.columns]
    )
    odd, noted = (
        suspicious.of_campaign(database, campaign.id),
        repairs.list_notes(database, campaign.robot, campaign.id),
    )
    return Shown(campaign, found, why, used, odd, columns, noted)


def _uses(version: Version, campaign_id: str) -> list[str]:
    return [used.use for used in version.campaigns if used.id == campaign_id]


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


def unit(database: Database, campaign: Campaign, name: str) -> str:
    """Return the unit of :func:`of_column`."""
    return next(display_unit_and_factor(one)[0] for one in looking.columns(database, campaign.id) if one.name == name)


def joint_columns(database: Database, campaign: Campaign) -> list[NDArray[np.float64]]:
    """Return the readings of the joints in their order, each row by row, in degrees or mm."""
    found = [one for one in looking.columns(database, campaign.id) if one.quantity == "q" and one.number is not None]
    return [of_column(database, campaign, one.name) for one in sorted(found, key=lambda one: one.number or 0)]


def _column(database: Database, campaign: Campaign, name: str) -> NDArray[np.float64]:
    """Read a column, and keep the others too: reading one of them takes as long as reading all."""
    rows = looking.load_campaign_rows(database, campaign.id)
    _keep(campaign, rows)
    return _values(rows, next(column for column in rows.columns if column.name == name))


def _keep(campaign: Campaign, rows: Rows) -> None:
    for column in rows.columns:
        KEPT.get((*campaign_cache_key(campaign), column.name), partial(_values, rows, column))


def _values(rows: Rows, column: Column) -> NDArray[np.float64]:
    cells = rows.table.column(column.name).to_numpy(zero_copy_only=False)
    return np.asarray(cells * display_unit_and_factor(column)[1], dtype=np.float64)
