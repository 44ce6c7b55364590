"""Where each of two versions is the better one: maps of the places that were measured, from above and from the side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.wire import to_mm
from kilter_service.page.figures.plot import BLUE, SKY, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.words import format_in_largest_unit, in_columns, largest
from kilter_service.versions.predictions import places as measured
from kilter_service.versions.predictions.paired import Pairs

if TYPE_CHECKING:
    from kilter_core.types import Floats, Ints


MOST_DRAWN, LARGEST = 1200, 200  # rows that are drawn, and how many of them are those that differ most


def maps(database: Database, found: Pairs, names: Sequence[str], version: str) -> list[Plot]:
    """Draw where each version is better on the rows that were paired. ``version`` says where the tools are."""
    table = found.tables[0]
    campaign, row = np.asarray(table["campaign"])[found.used], np.asarray(table["row"])[found.used]
    return _maps(database, version, campaign, row, found.sizes[0] - found.sizes[1], names)


def _maps(
    database: Database, version: str, campaign: Any, row: Ints, difference: Floats, names: Sequence[str]
) -> list[Plot]:
    """Where each version is the better one, from above and from the side; nothing where tools have no place."""
    places, gains, rows = [], [], []
    for one in dict.fromkeys(campaign.tolist()):
        try:
            found = measured.places(database, version, one)
        except ServiceError:
            return []
        mine = dict(zip(row[campaign == one].tolist(), difference[campaign == one].tolist(), strict=True))
        kept = [k for k, number in enumerate(found.row.tolist()) if number in mine]
        places.append(to_mm(found.at[kept]))
        gains += [mine[number] for number in found.row[kept].tolist()]
        rows += [f"{one}/{number}" for number in found.row[kept].tolist()]
    at, gain = np.concatenate(places), np.array(gains)
    drawn = _drawn(gain)
    return [
        _map(title, at[drawn], gain[drawn], [rows[int(k)] for k in drawn], axes, names)
        for title, axes in (("From above", (0, 1)), ("From the side", (0, 2)))
    ]


def _drawn(gain: Floats) -> Ints:
    if len(gain) <= MOST_DRAWN:
        return np.arange(len(gain))
    even = np.linspace(0, len(gain) - 1, MOST_DRAWN - LARGEST).astype(np.int64)
    return np.union1d(even, np.argsort(-np.abs(gain))[:LARGEST])


def _map(
    title: str, at: Floats, gain: Floats, rows: Sequence[str], axes: tuple[int, int], names: Sequence[str]
) -> Plot:
    across, up = axes
    plot = Plot(
        title,
        around(f"{'xyz'[across]}, mm", at[:, across].tolist()),
        around(f"{'xyz'[up]}, mm", at[:, up].tolist()),
        width=480.0,
        height=340.0,
        description=f"{title}: at which measured places {names[1]} is better than {names[0]}, and where it is worse.",
    )
    most = largest(gain)
    for better, label, number, colour in (
        (True, f"{names[1]} better", 1, SKY),
        (False, f"{names[0]} better", 0, BLUE),
    ):
        part = np.flatnonzero((gain > 0) == better)
        if len(part):
            told = [f"{format_in_largest_unit(abs(gain[k]), most)} {'less' if better else 'more'} left" for k in part]
            plot.points(
                at[part, across].tolist(),
                at[part, up].tolist(),
                label,
                number,
                colour,
                told,
                [rows[int(k)] for k in part],
            )
    worst = np.argsort(gain)[:10]
    unit, more = in_columns([[float(-gain[k])] for k in worst])
    numbers = [
        [rows[int(k)].rpartition("/")[2], *(f"{v:.0f}" for v in at[k]), left]
        for k, (left,) in zip(worst, more, strict=True)
    ]
    plot.table = (["Row", "x, mm", "y, mm", "z, mm", f"More left by {names[1]}, {unit}"], numbers)
    return plot
