"""Two versions side by side, and what would change by activating one.

What a version leaves of its rows by what may cause it: joint readings, directions, load, temperature, order in time.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.observations import with_directions
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.versions import Version, VersionPreview
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.paging import Page
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.wire import joint_scale, to_mm
from kilter_service.page.figures.plot import (
    BLUE,
    CORRECTED,
    FITTED,
    HELD_OUT,
    SKY,
    Group,
    Plot,
    Table,
    around,
    lengths,
    places_from_two_sides,
)
from kilter_service.page.shared.errors_drawn import grouped_bars, rows_to_draw
from kilter_service.page.shared.standing import accuracy_from_metrics
from kilter_service.page.words import format_in_largest_unit, in_columns, largest
from kilter_service.robots import service as robots
from kilter_service.robots.compensation import sentence
from kilter_service.robots.exporters.registry import FORMATS
from kilter_service.versions import activation, service
from kilter_service.versions.if_match import tag_of_robot
from kilter_service.versions.predictions import differences
from kilter_service.versions.predictions import places as measured
from kilter_service.versions.predictions.at_pose import preview
from kilter_service.versions.predictions.differences import Pairs, error_lengths, residuals

if TYPE_CHECKING:
    from kilter_core.types import Floats


def maps(database: Database, found: Pairs, names: Sequence[str], version: str) -> list[Plot]:
    """Draw where each version is better on the rows that were paired; nothing where tools have no place.

    ``version`` says where the tools are.
    """
    table = found.tables[0]
    campaign, row = np.asarray(table["campaign"])[found.used], np.asarray(table["row"])[found.used]
    difference = found.sizes[0] - found.sizes[1]
    places, gains, rows = [], [], []
    for one in dict.fromkeys(campaign.tolist()):
        try:
            seen = measured.places(database, version, one)
        except ServiceError:
            return []
        mine = dict(zip(row[campaign == one].tolist(), difference[campaign == one].tolist(), strict=True))
        kept = [k for k, number in enumerate(seen.row.tolist()) if number in mine]
        places.append(to_mm(seen.at[kept]))
        gains += [mine[number] for number in seen.row[kept].tolist()]
        rows += [f"{one}/{number}" for number in seen.row[kept].tolist()]
    at, gain = np.concatenate(places), np.array(gains)
    drawn = rows_to_draw(np.abs(gain))
    return _maps(at[drawn], gain[drawn], [rows[int(k)] for k in drawn], names)


def _maps(at: Floats, gain: Floats, rows: Sequence[str], names: Sequence[str]) -> list[Plot]:
    most, groups = largest(gain), list[Group]()
    for better, name, number, colour in ((True, names[1], 1, SKY), (False, names[0], 0, BLUE)):
        part = np.flatnonzero((gain > 0) == better).tolist()
        told = [f"{format_in_largest_unit(abs(gain[k]), most)} {'less' if better else 'more'} left" for k in part]
        groups.append((f"{name} better", number, colour, part, told, [rows[k] for k in part]))
    worst = np.argsort(gain)[:10]
    unit, more = in_columns([[float(-gain[k])] for k in worst])
    numbers = [
        [rows[int(k)].rpartition("/")[2], *(f"{v:.0f}" for v in at[k]), left]
        for k, (left,) in zip(worst, more, strict=True)
    ]
    table = (["Row", "x, mm", "y, mm", "z, mm", f"More left by {names[1]}, {unit}"], numbers)
    about = f": at which measured places {names[1]} is better than {names[0]}, and where it is worse."
    return places_from_two_sides(at.tolist(), groups, about, table, (480.0, 340.0))


MOST_CAMPAIGNS, MOST_VERSIONS = 20, 12
MOST_AT_ONCE = 5000  # rows that are paired before the view is sent: 0.15 s of processor
SAME = 1e-9  # smaller differences are rounding
STEPS = 200  # of a cumulative curve
MEASURES = {"mean_mm": "mean", "p95_mm": "95 % of the rows", "max_mm": "largest"}


@dataclass(frozen=True)
class Left:
    """What one of the versions leaves of rows, the sizes in mm."""

    name: str
    sizes: Sequence[float]

    @property
    def numbers(self) -> Mapping[str, float]:
        """Mean, 95th percentile and largest, mm."""
        sizes = np.asarray(self.sizes)
        found = (float(sizes.mean()), float(np.percentile(sizes, 95)), float(sizes.max()))
        return dict(zip(MEASURES, found, strict=True))


Compared = dict[str, Any]


def compared_versions(database: Database, a: str, b: str, wanted: Sequence[str] | None, whole: bool = True) -> Compared:
    """Compare two versions on rows held out of both, where there are such; many rows only for the ``whole``.

    ``moved`` are parameters that differ by more than their uncertainty, or are in one version only, ``within`` the others that
    differ, ``same`` how many do not; ``later`` rows are paired only when the view has asked for them.
    """

    def few(chosen: Sequence[str]) -> bool:
        robot = service.get(database, differences.resolve_version_id(a)).robot
        there = campaigns.list_campaigns(database, robot, Page()).campaigns
        return sum(one.rows for one in there if one.id in chosen) <= MOST_AT_ONCE

    found = differences.compare_versions(database, a, b, wanted or (), None if whole else few)
    diff, rows = found.diff, found.pairs
    sides = [None if name == differences.NOMINAL else service.get(database, name) for name in (diff.a, diff.b)]
    known = next(side for side in sides if side is not None)
    there = [one for one in campaigns.list_campaigns(database, known.robot, Page()).campaigns if one.rows]
    names = [display_name(side) for side in sides if side is not None]
    left = [] if rows is None else [Left(n, sizes.tolist()) for n, sizes in zip(names, rows.sizes, strict=True)]
    changed = [one for one in diff.parameters if one.change is None or abs(one.change) > SAME]
    told = diff.paired is not None or diff.not_paired
    return {
        "robot": known.robot,
        "a": sides[0],
        "b": sides[1],
        "diff": diff,
        "paired": diff.paired,
        "moved": [one for one in changed if one.moved],
        "within": [one for one in changed if not one.moved],
        "same": len(diff.parameters) - len(changed),
        "campaigns": there,
        "chosen": found.campaigns,
        "later": 0 if told else sum(one.rows for one in there if one.id in found.campaigns),
        "left": left,
        "bars": _bars(left) if left else None,
        "curve": _curve(left) if left else None,
        "maps": [] if rows is None else maps(database, rows, names, diff.b),
    }


def several(
    database: Database, robot: str, wanted: Sequence[str], whole: bool
) -> list[tuple[Version, Compared | None]]:
    """Compare versions each with the first, on the campaigns that are usual for that one; many rows only for the ``whole``.

    Raises:
        ServiceError: fewer than two, or no such version of the robot.

    """
    if len(wanted) < 2:
        raise ServiceError("Tick at least two versions to compare them.", code="option_invalid", option="version")
    found = [service.get(database, one) for one in wanted]
    for one in found:
        if one.robot != robot:
            raise ServiceError(
                f"Version {one.id} is of robot {one.robot}: choose those of {robot}.", code="option_invalid"
            )
    first, second, *others = found
    usual = compared_versions(database, first.id, second.id, None, whole)
    rest = [(one, compared_versions(database, first.id, one.id, usual["chosen"], whole)) for one in others]
    return [(first, None), (second, usual), *rest]


def _bars(left: Sequence[Left]) -> Plot:
    return grouped_bars(
        "Errors on the same rows",
        list(MEASURES.values()),
        [(one.name, "", [one.numbers[measure] for measure in MEASURES]) for one in left],
        size=(640.0, 280.0),
        description="Mean, 95th percentile and largest error of each version on the rows chosen.",
    )


def _curve(left: Sequence[Left]) -> Plot:
    shares = np.linspace(0.0, 100.0, STEPS + 1)
    told = (10, 25, 50, 75, 90, 95, 99, 100)
    found = [np.percentile(np.asarray(one.sizes), [*shares, *told]) for one in left]
    curves = [one[: len(shares)] for one in found]
    unit, sizes = in_columns(np.transpose([one[len(shares) :] for one in found]).tolist())
    drawn = Plot(
        "Share of the rows within an error",
        lengths("error", [float(c[-1]) for c in curves], zero=True),
        around("rows within it, %", [0.0, 100.0], zero=True),
        height=280.0,
        description="Cumulative curves: how many of the rows have at most a given error. Further left is better.",
        table=(
            ["rows, %", *(f"{one.name}, {unit}" for one in left)],
            [[f"{share}", *row] for share, row in zip(told, sizes, strict=True)],
        ),
    )
    for number, (one, curve) in enumerate(zip(left, curves, strict=True)):
        drawn.line(curve.tolist(), shares.tolist(), one.name, number)
    return drawn


log = logging.getLogger("kilter.page")

NAMES = {
    "json": "Kilter's own document",
    "urdf": "URDF",
    "mjcf": "calibrated twin for MuJoCo",
    "usd": "calibrated twin for simulators of USD",
    "dh-csv": "table of DH parameters",
    "mdh-csv": "table of modified DH parameters",
    "ur-yaml": "calibration of the Universal Robots driver",
    "matlab": "function for MATLAB",
    "ranges": "ranges and draws to train with",
    "corrector": "program for the corrector in C",
    "c": "corrector and program as one C file",
    "torque-c": "torques of a setpoint as one C file",
}
REFUSED = {
    "CORRECTION_TOO_LARGE": "the correction is larger than the version's limits",
    "JOINT_LIMIT": "the corrected joint is outside its limits",
    "RATE_LIMIT": "the correction changes too fast",
    "NOT_FINITE": "no correction is found there",
}


def correction_ahead(database: Database, version_id: str, temperature_c: float | None) -> dict[str, Any]:
    """Look at what a version would do. A preview that fails is a sentence: it decides nothing, and keeps nobody.

    ``etag`` is the state that this was looked at in, ``larger`` the larger of the two errors, mm, whose unit both have,
    ``controller`` what follows from what the controller does by itself, empty where nothing does.
    """
    found = service.get(database, version_id)
    etag = tag_of_robot(database, found.robot)  # before the rest: what changes meanwhile is refused later
    robot = robots.get(database, found.robot)
    active = None if robot.active_version is None else service.get(database, robot.active_version)
    errors = [None if one is None else accuracy_from_metrics(one.metrics) for one in (found, active)]
    preview, failed = _try_preview(database, version_id, temperature_c)
    units = [" mm" if joint.kind == "prismatic" else "°" for joint in robot.joints]
    largest_at, refused = ([], {}) if preview is None else (preview.largest_at or [], preview.refused)
    angles = zip(robot.joints, largest_at, units, strict=False)
    return {
        "version": found,
        "accuracy": errors[0],
        "active": active,
        "active_accuracy": errors[1],
        "larger": max((one.mean for one in errors if one is not None), default=0.0),
        "preview": preview,
        "failed": failed,
        "where": [(joint.name, f"{value:.1f}{unit}") for joint, value, unit in angles],
        "refused": [(count, REFUSED.get(why, why.lower().replace("_", " "))) for why, count in refused.items()],
        "etag": etag,
        "controller": sentence(found.robot, robot.controller_compensation),
    }


def _try_preview(database: Database, version_id: str, temperature_c: float | None) -> tuple[VersionPreview | None, str]:
    """The preview, or why there is none."""
    try:
        return preview(database, version_id, temperature_c), ""
    except CoreError as error:
        return None, f"What it would correct could not be computed: {error.message}"
    except Exception:
        log.exception("the preview of version %s failed", version_id)
        return None, (
            "What it would correct could not be computed; the server's log has the cause. Going on does not need it: only "
            "look at a corrected path before the arm moves by it."
        )


def back(database: Database, robot: str, temperature_c: float | None) -> dict[str, Any]:
    """Look at what a roll-back would do.

    Raises:
        ServiceError: there is no version to go back to.

    """
    return correction_ahead(database, activation.rollback_target(database, robot), temperature_c)


def exports(database: Database, version_id: str) -> list[dict[str, Any]]:
    """Return each format that a version can be written as: what its file leaves out, or why it cannot be."""
    found = []
    for name in FORMATS:
        notes: Sequence[str] = ()
        refusal = ""
        try:
            notes = service.exported_notes(database, version_id, name)
        except CoreError as error:  # a format that cannot hold this arm
            refusal = error.message
        found.append({"format": name, "name": NAMES.get(name, name), "notes": notes, "refusal": refusal})
    return found


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
