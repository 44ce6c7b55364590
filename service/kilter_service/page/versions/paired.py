"""Two versions pose by pose: which one is better where, by how much, and how often chance alone would say so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations.repeats import numbered_poses
from kilter_service.campaigns import looking
from kilter_service.db import Database
from kilter_service.errors import ServiceError
from kilter_service.page.figures.plot import BLUE, ORANGE, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.shared.left import size_of
from kilter_service.page.words import mm
from kilter_service.tables.assemble import observations
from kilter_service.versions import service
from kilter_service.wire import to_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]


POSES_OF_INTERVAL = 3  # poses that an interval of a mean needs
MOST_DRAWN, LARGEST = 1200, 200  # rows that are drawn, and how many of them are those that differ most
EQUAL_MM = 1e-9  # smaller differences are rounding


@dataclass(frozen=True)
class Paired:
    """On ``poses`` the second version is better on ``better`` and worse on ``worse``, equal on the rest.

    ``chance`` is how often at least so uneven a count comes if neither is better (exact sign test, two-sided), ``mean`` how
    much less the second leaves, mm, with its 95 % interval (Student's; None: too few poses). Rows of one pose are one.
    """

    rows: int
    poses: int
    better: int
    worse: int
    chance: float
    mean: float
    low: float | None
    high: float | None
    maps: Sequence[Plot]

    @property
    def what(self) -> str:
        """What is counted."""
        return "rows" if self.poses == self.rows else "poses"


def paired(
    database: Database, tables: Sequence[Mapping[str, Any]], names: Sequence[str], version: str
) -> Paired | None:
    """Pair what two versions leave of the same rows; None where no row was seen. ``version`` says where the tools are."""
    first, second = (size_of(table) for table in tables)
    seen = ~np.isnan(first) & ~np.isnan(second)
    if not seen.any():
        return None
    difference = (first - second)[seen]
    groups = _poses(database, tables[0])[seen]
    _, pose = np.unique(groups, return_inverse=True)
    means = np.bincount(pose, weights=difference) / np.bincount(pose)
    better, worse = int((means > EQUAL_MM).sum()), int((means < -EQUAL_MM).sum())
    mean, low, high = _interval(means)
    campaign, row = np.asarray(tables[0]["campaign"])[seen], np.asarray(tables[0]["row"])[seen]
    return Paired(
        len(difference), len(means), better, worse, chance(better, worse), mean, low, high,
        _maps(database, version, campaign, row, difference, names),
    )  # fmt: skip


def chance(better: int, worse: int) -> float:
    """Probability of at least so uneven a count where both are equally likely: exact sign test, two-sided."""
    from scipy.stats import binomtest

    return float(binomtest(better, better + worse, 0.5).pvalue) if better + worse else 1.0


def _interval(means: Floats) -> tuple[float, float | None, float | None]:
    from scipy.stats import t

    mean, count = float(means.mean()), len(means)
    if count < POSES_OF_INTERVAL:
        return mean, None, None
    half = float(t.ppf(0.975, count - 1) * means.std(ddof=1) / np.sqrt(count))
    return mean, mean - half, mean + half


def _poses(database: Database, table: Mapping[str, Any]) -> Ints:
    """Number the poses of all rows, those of each campaign apart."""
    found, last = [], 0
    for campaign in dict.fromkeys(table["campaign"]):
        rows = looking.stored(database, campaign)
        seen = observations(rows.table, rows.columns, rows.conditions)
        own = numbered_poses(seen.q) if seen.pose_id is None else np.unique(seen.pose_groups(), return_inverse=True)[1]
        found.append(own + last)
        last += int(own.max(initial=-1)) + 1
    return np.concatenate(found)


def _maps(
    database: Database, version: str, campaign: Any, row: Ints, difference: Floats, names: Sequence[str]
) -> list[Plot]:
    """Where each version is the better one, from above and from the side; nothing where tools have no place."""
    places, gains, rows = [], [], []
    for one in dict.fromkeys(campaign.tolist()):
        try:
            found = service.places(database, version, one)
        except ServiceError:
            return []
        mine = dict(zip(row[campaign == one].tolist(), difference[campaign == one].tolist(), strict=True))
        kept = [k for k, number in enumerate(found.row.tolist()) if number in mine]
        places.append(to_mm(found.at[kept]))
        gains += [mine[number] for number in found.row[kept].tolist()]
        rows += [f"{one}/{number}" for number in found.row[kept].tolist()]
    at, gain = np.concatenate(places), np.array(gains)
    drawn = _drawn(gain)
    return [_map(title, at[drawn], gain[drawn], [rows[int(k)] for k in drawn], axes, names)
            for title, axes in (("From above", (0, 1)), ("From the side", (0, 2)))]  # fmt: skip


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
        title, around(f"{'xyz'[across]}, mm", at[:, across].tolist()), around(f"{'xyz'[up]}, mm", at[:, up].tolist()),
        width=480.0, height=340.0,
        description=f"{title}: at which measured places {names[1]} is better than {names[0]}, and where it is worse.",
    )  # fmt: skip
    for better, label, number, colour in (
        (True, f"{names[1]} better", 1, ORANGE),
        (False, f"{names[0]} better", 0, BLUE),
    ):
        part = np.flatnonzero((gain > 0) == better)
        if len(part):
            told = [f"{mm(abs(gain[k]))} {'less' if better else 'more'} left" for k in part]
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
    numbers = [[rows[int(k)].rpartition("/")[2], *(f"{v:.0f}" for v in at[k]), mm(-gain[k])] for k in worst]
    plot.table = (["Row", "x, mm", "y, mm", "z, mm", f"More left by {names[1]}"], numbers)
    return plot
