"""What a version leaves of its rows by what may cause it: joint readings, directions, load, temperature, order in time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import with_directions
from kilter_service.campaigns import looking
from kilter_service.ground.db import Database
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.wire import joint_scale
from kilter_service.page.figures.plot import CORRECTED, FITTED, HELD_OUT, Plot, Table, around, lengths
from kilter_service.page.shared.errors_drawn import grouped_bars, rows_to_draw
from kilter_service.page.words import in_columns
from kilter_service.versions import service
from kilter_service.versions.predictions.differences import error_lengths, residuals

if TYPE_CHECKING:
    from kilter_core.types import Floats


BINS, ROWS_OF_MEAN = 10, 5  # bins of about as many rows each, and rows from which a mean is shown
SURE = 1.96  # standard errors on each side of a mean: 95 %


@dataclass(frozen=True)
class Cause:
    """Something that varies from row to row; ``names`` where it has few values."""

    title: str
    label: str
    values: Floats
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Seen:
    """Rows by their causes: sizes of the errors, mm, which were held out of the fit, and what tells each row."""

    causes: Sequence[Cause]
    sizes: Floats
    held_out: Any
    rows: Sequence[str]


def figures(database: Database, version_id: str, wanted: Sequence[str]) -> list[tuple[str, Plot]]:
    """Draw the errors of the rows of campaigns by each cause that varies; by default of those a version was made from.

    Raises:
        ServiceError: no such version, or one that was made from no campaign.
        ObservationError: a campaign without a measured position.

    """
    seen = _load_residuals_and_causes(database, version_id, wanted)
    return [(cause.title, _levels(seen, cause) if cause.names else _course(seen, cause)) for cause in seen.causes]


def _load_residuals_and_causes(database: Database, version_id: str, wanted: Sequence[str]) -> Seen:
    version = service.get(database, version_id)
    chosen = list(dict.fromkeys(wanted or (used.id for used in version.campaigns)))
    table = residuals(database, version_id, chosen)
    every = [_causes(looking.load_campaign_rows(database, campaign)) for campaign in chosen]
    shared = [cause.title for cause in every[0] if all(any(o.title == cause.title for o in one) for one in every)]
    joined = [
        Cause(found[0].title, found[0].label, np.concatenate([one.values for one in found]), found[0].names)
        for found in ([next(o for o in one if o.title == title) for one in every] for title in shared)
    ]
    sizes = error_lengths(table)
    order = Cause("in the order of the rows", "row, the campaigns one after the other", np.arange(1.0, len(sizes) + 1))
    varying = [cause for cause in [*joined, order] if len(np.unique(cause.values[~np.isnan(cause.values)])) > 1]
    rows = [f"{campaign}/{row}" for campaign, row in zip(table["campaign"], table["row"], strict=True)]
    return Seen(varying, sizes, np.asarray(table["held_out"], dtype=bool), rows)


def _causes(rows: looking.Rows) -> list[Cause]:
    seen = with_directions(observations(rows.table, rows.columns, rows.conditions))
    out = []
    signs = np.zeros_like(seen.q) if seen.direction is None else seen.direction
    for k, joint in enumerate(rows.robot.joints):
        unit = "mm" if joint.kind == "prismatic" else "deg"
        out.append(
            Cause(f"by the reading of {joint.name}", f"{joint.name}, {unit}", seen.q[:, k] * joint_scale(rows.robot)[k])
        )
    for k, joint in enumerate(rows.robot.joints):
        sign = np.sign(np.asarray(signs[:, k], dtype=np.float64))
        where = np.where(sign < 0, 0.0, np.where(sign > 0, 1.0, np.nan))
        out.append(Cause(f"by the direction {joint.name} came from", joint.name, where, ("from above", "from below")))
    for title, label, values in (
        ("by the load", "load, kg", seen.payload_kg),
        ("by the temperature", "temperature, °C", seen.temperature_c),
        ("by the time", "time, s", seen.t),
    ):
        if values is not None:
            out.append(Cause(title, label, np.asarray(values, dtype=np.float64)))
    return out


def _course(seen: Seen, cause: Cause) -> Plot:
    """Points of the rows, and means of bins with their 95 % intervals."""
    there = np.flatnonzero(~np.isnan(cause.values) & ~np.isnan(seen.sizes))
    found = [_mean(seen.sizes[part], cause.values[part]) for part in _equal_count_bins(there, cause.values)]
    bins = [one for one in found if one is not None]
    drawn = there[rows_to_draw(seen.sizes[there])]
    plot = Plot(
        f"Error {cause.title}",
        around(cause.label, cause.values[there].tolist()),
        lengths("error", seen.sizes[drawn].tolist(), zero=True),
        width=560.0,
        description="A mean that rises or falls beyond its intervals says that the model misses something there.",
        table=_table("From about", [f"{one[0]:.4g}" for one in bins], bins),
    )
    for held, label, number in ((False, "fitted", 0), (True, "held out", 1)):
        part = drawn[seen.held_out[drawn] == held]
        if len(part):
            xs, ys, rows = cause.values[part].tolist(), seen.sizes[part].tolist(), [seen.rows[k] for k in part]
            plot.points(xs, ys, label, number, (FITTED, HELD_OUT)[number], rows=rows)
    xs, means, lows, highs = ([one[k] for one in bins] for k in range(4))
    if xs:
        plot.band(xs, lows, highs, "95 % of the mean").line(xs, means, "mean of a bin", colour=CORRECTED)
    return plot


def _levels(seen: Seen, cause: Cause) -> Plot:
    """The mean error at each of a few values."""
    names, bars = [], []
    for level, name in enumerate(cause.names):
        part = np.flatnonzero((cause.values == level) & ~np.isnan(seen.sizes))
        found = _mean(seen.sizes[part], cause.values[part])
        if found is not None:
            names.append(name)
            bars.append(found)
    return grouped_bars(
        f"Error {cause.title}",
        names,
        [("", "", [one[1] for one in bars])],
        what="mean error",
        across=cause.label,
        size=(280.0, 240.0),
        description="Whiskers are the 95 % interval of the mean.",
        table=_table("Direction", names, bars),
        errors=[(one[2], one[3]) for one in bars],
    )


def _table(what: str, names: Sequence[str], bins: Sequence[tuple[float, float, float, float, int]]) -> Table:
    """Means and their intervals below heads that name their unit."""
    unit, sizes = in_columns([one[1:4] for one in bins])
    rows = [
        [name, mean, f"{low} to {high}", str(one[4])]
        for name, (mean, low, high), one in zip(names, sizes, bins, strict=True)
    ]
    return [what, f"Mean error, {unit}", f"95 % interval of the mean, {unit}", "Rows"], rows


def _equal_count_bins(there: Any, values: Floats) -> Iterator[Any]:
    """Rows of bins with about as many each, from the lowest value on."""
    return iter(np.array_split(there[np.argsort(values[there], kind="stable")], BINS))


def _mean(sizes: Floats, values: Floats) -> tuple[float, float, float, float, int] | None:
    """Middle of the cause, mean error, its 95 % interval, and rows; None: too few rows."""
    if len(sizes) < ROWS_OF_MEAN:
        return None
    mean, error = float(sizes.mean()), float(sizes.std(ddof=1)) / math.sqrt(len(sizes))
    return float(np.median(values)), mean, max(mean - SURE * error, 0.0), mean + SURE * error, len(sizes)
