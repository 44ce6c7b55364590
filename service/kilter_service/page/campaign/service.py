"""What the views of campaigns show, by the service functions of the features."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from kilter_core.errors import CoreError, ObservationError
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.versions import Version
from kilter_service.db import Database
from kilter_service.page.campaign.series import KEPT, LEAST, MOST, thinned
from kilter_service.page.shared.measured import Seen, seen
from kilter_service.paging import Page
from kilter_service.versions import service as versions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from kilter_service.campaigns.columns import Column
    from kilter_service.campaigns.facts import Facts
    from kilter_service.campaigns.looking import Rows

MOST_FACTS = 24
MOST_ASIDE = 1000
_facts: OrderedDict[tuple[str, ...], Facts] = OrderedDict()
_lock = threading.Lock()


@dataclass(frozen=True)
class Aside:
    """A row that a version set aside."""

    row: int
    version: Version
    sigma: float | None
    weight: float | None


@dataclass(frozen=True)
class Shown:
    """A campaign, its rows (None: it has none, ``why`` says why), the versions made with it, and rows set aside."""

    campaign: Campaign
    seen: Seen | None
    why: str
    made: list[tuple[Version, str]]
    aside: list[Aside]
    columns: list[tuple[str, str]]


def listed(database: Database, robot: str, with_retired: bool) -> list[Campaign]:
    """Return the campaigns of a robot, newest first."""
    return campaigns.listed(database, robot, Page(), False, with_retired).campaigns[::-1]


def shown(database: Database, campaign_id: str) -> Shown:
    """Return all that is shown of a campaign."""
    campaign = campaigns.get(database, campaign_id)
    found, why = None, ""
    try:
        found = seen(_kept_facts(database, campaign))
    except CoreError as error:
        why = error.message
    used = [
        (version, use) for version in versions.made_with(database, campaign.id) for use in _uses(version, campaign.id)
    ]
    aside = [one for version, _ in used for one in _aside(version, campaign.id)]
    columns = (
        [] if found is None else [(one[0], f"{one[1]}, {one[2]}" if one[2] != "–" else one[1]) for one in found.columns]
    )
    return Shown(campaign, found, why, used, sorted(aside, key=lambda one: one.row)[:MOST_ASIDE], columns)


def _key(campaign: Campaign) -> tuple[str, ...]:
    return campaign.id, str(campaign.conditions), *(upload.sha256 for upload in campaign.uploads)


def _kept_facts(database: Database, campaign: Campaign) -> Facts:
    """Return the facts of a campaign; those of the last few that were looked at are kept."""
    from kilter_service.campaigns.facts import facts  # compiled kernels: not at the start of the API process

    key = _key(campaign)
    with _lock:
        if key in _facts:
            _facts.move_to_end(key)
            return _facts[key]
    rows = looking.stored(database, campaign.id)
    found = facts(rows)
    _keep(campaign, rows)  # whoever looks at the page looks at its columns next
    with _lock:
        _facts[key] = found
        while len(_facts) > MOST_FACTS:
            _facts.popitem(last=False)
    return found


def _uses(version: Version, campaign_id: str) -> list[str]:
    return [used.use for used in version.campaigns if used.id == campaign_id]


def _aside(version: Version, campaign_id: str) -> list[Aside]:
    return [
        Aside(one.row, version, one.residual_sigma, one.weight)
        for one in version.details.set_aside or []
        if one.campaign in (campaign_id, None)
    ]


def series(
    database: Database, campaign_id: str, column: str, first: int, last: int, width: int, keep: Sequence[int]
) -> dict[str, Any]:
    """Return a column as points to draw, in the unit that people read.

    Raises:
        ObservationError: the campaign has no such column.

    """
    campaign = campaigns.get(database, campaign_id)
    names = campaign.uploads[0].columns if campaign.uploads else []
    if column not in names:
        raise ObservationError(
            f"Campaign {campaign_id} has no column {column[:64]!r}: it has {', '.join(names[:20]) or 'none'}.",
            column=column[:64],
        )
    values = KEPT.get((*_key(campaign), column), lambda: _column(database, campaign, column))
    rows, shown = thinned(values, first, last if last > 0 else len(values), min(max(width, LEAST), MOST), keep)
    return {"column": column, "rows": len(values), "x": rows, "y": shown}


def _column(database: Database, campaign: Campaign, name: str) -> NDArray[np.float64]:
    """Read a column, and keep the others too: reading one of them takes as long as reading all."""
    rows = looking.stored(database, campaign.id)
    _keep(campaign, rows)
    return _values(rows, next(column for column in rows.columns if column.name == name))


def _keep(campaign: Campaign, rows: Rows) -> None:
    for column in rows.columns:
        KEPT.get((*_key(campaign), column.name), partial(_values, rows, column))


def _values(rows: Rows, column: Column) -> NDArray[np.float64]:
    import numpy as np

    from kilter_service.campaigns.facts import unit_of

    cells = rows.table.column(column.name).to_numpy(zero_copy_only=False)
    return np.asarray(cells * unit_of(column)[1], dtype=np.float64)
