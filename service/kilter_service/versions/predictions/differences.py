"""How two versions differ, or a version and the nominal robot.

Two versions on the same rows, pose by pose: which one is better, by how much, and how often chance alone says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.observations import numbered_poses
from kilter_core.parameters import display_unit_and_scale
from kilter_files.ground.later import special
from kilter_service.campaigns import looking
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.fits import Metrics
from kilter_service.contract.versions import PairedErrors, ParameterChange, VersionDiff
from kilter_service.contract.wording import said_of_chance, said_of_lengths
from kilter_service.ground.core import transforms
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.tables.assemble import observations
from kilter_service.versions import store
from kilter_service.versions.predictions import unfitted_rows as left
from kilter_service.versions.wire import summary

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_core.types import Bools, Floats, Ints


FRAME = (("x", "mm"), ("y", "mm"), ("z", "mm"), ("rx", "deg"), ("ry", "deg"), ("rz", "deg"))


class Value(NamedTuple):
    """A number and its unit."""

    value: float
    unit: str


def wire_values(calibration: Calibration) -> dict[str, Value]:
    """Return every parameter by name; base and tool as x, y, z and rx, ry, rz (URDF) next to the nominal ones."""
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    out = {}
    for parameter, value in zip(model.parameters, values, strict=True):
        unit, scale = display_unit_and_scale(parameter.unit)
        out[parameter.name] = Value(float(value) * scale, unit)
    robot = calibration.robot
    for which, T, nominal in (("base", model.T_base, robot.T_base), ("tool", model.T_tool, robot.T_tool)):
        near = transforms.xyz_rpy_from_pose(np.asarray(nominal))[1]
        xyz, rpy = transforms.xyz_rpy_from_pose(np.asarray(T), near)
        numbers = [*(xyz * 1e3), *np.degrees(rpy)]
        out |= {f"{which}_{k}": Value(float(v), unit) for (k, unit), v in zip(FRAME, numbers, strict=True)}
    return out


NOMINAL = "nominal"
MOST_CAMPAIGNS = 20  # whose rows are compared without asking
ROUNDING = 1e-9  # smaller changes are none
SURE = 1.96  # standard deviations: 95 %
NO_BASE = "The nominal robot has no base to be compared in: rows are compared between two versions."
UNMEASURED = "This robot has no measurements to compare on."


class _Side(NamedTuple):
    """What is compared: effects, values, standard deviations and errors, in the units of the wire."""

    name: str
    robot: str
    effects: list[str]
    values: dict[str, Value]
    sigma: dict[str, float]
    metrics: Metrics
    called: str = ""


@dataclass(frozen=True)
class Compared:
    """How two versions differ, the campaigns on whose rows, and these rows paired; none where it cannot be said."""

    diff: VersionDiff
    campaigns: Sequence[str]
    pairs: Pairs | None


def diff(database: Database, a: str, b: str, wanted: Sequence[str] = ()) -> VersionDiff:
    """Compare two versions of one robot; either may be ``nominal``: the nominal robot with the other's effects at zero.

    A job stands for the version that it made. Rows are those of the campaigns ``wanted``, by default of all that either
    version was made from, else of the newest campaign.

    Raises:
        ServiceError: they are of different robots, or both are nominal.

    """
    return compare_versions(database, a, b, wanted).diff


def compare_versions(
    database: Database, a: str, b: str, wanted: Sequence[str] = (), few: Callable[[Sequence[str]], bool] | None = None
) -> Compared:
    """Compare two versions as ``diff`` does, and keep the rows.

    Where ``few`` says no of the campaigns, rows are left alone: neither ``paired`` nor ``not_paired`` is said.
    """
    a, b = resolve_version_id(a), resolve_version_id(b)
    if a == b == NOMINAL:
        raise ServiceError(f"Both are {NOMINAL!r}: name a version to compare with it.", code="option_invalid")
    with database.reading() as session:
        first = None if a == NOMINAL else _of_version(session, a)
        second = None if b == NOMINAL else _of_version(session, b)
        known = first or second
        assert known is not None
        drawn = _Side(NOMINAL, known.robot, [], _drawn(session, b if a == NOMINAL else a), {}, Metrics())
        found = _diff_sides(first or drawn, second or drawn)
        chosen = list(wanted) or _usual(session, [one for one in (a, b) if one != NOMINAL])
    if first is None or second is None:
        return Compared(found.model_copy(update={"not_paired": NO_BASE}), chosen, None)
    if not chosen:
        return Compared(found.model_copy(update={"not_paired": UNMEASURED}), chosen, None)
    if few is not None and not few(chosen):
        return Compared(found, chosen, None)
    try:
        rows = pairs(database, a, b, chosen)
        said = judge_pairs(database, rows, *(Side(one.name, one.called or one.name) for one in (first, second)))
    except CoreError as error:
        return Compared(found.model_copy(update={"not_paired": error.message}), chosen, None)
    if said is None:
        return Compared(found.model_copy(update={"not_paired": NOTHING}), chosen, None)
    return Compared(found.model_copy(update={"paired": said}), chosen, rows)


def resolve_version_id(name: str) -> str:
    """Return the version that a job made, for its id; any other name as it is."""
    return f"ver_{name.removeprefix('job_')}" if name.startswith("job_") else name


def _usual(session: Session, versions: Sequence[str]) -> list[str]:
    """Campaigns that either version was made from, else the newest of the robot."""
    rows = [store.get(session, one) for one in versions]
    used = list(dict.fromkeys(part["id"] for row in rows for part in row.campaigns))
    there = [
        one for one in campaigns.ids_of_robot(session, rows[0].robot_id) if campaigns.uploads_of_campaign(session, one)
    ]
    known = [one for one in used if one in there][:MOST_CAMPAIGNS]
    return known or there[-1:]


def _of_version(session: Session, version: str) -> _Side:
    record = store.get(session, version)
    about = summary(record)
    rows = record.report.get("parameters") or []
    sigma = {row["name"]: float(row["sigma"]) for row in rows if row.get("sigma") is not None}
    return _Side(
        version,
        about.robot,
        about.effects,
        wire_values(store.calibration(session, version)),
        sigma,
        about.metrics,
        display_name(about),
    )


def _drawn(session: Session, version: str) -> dict[str, Value]:
    """Values of the nominal robot for everything that a version has a number for."""
    calibration: Calibration = store.calibration(session, version)
    robot, model = calibration.robot, calibration.model
    nominal = replace(model, T_base=robot.T_base, T_tool=robot.T_tool)
    return wire_values(replace(calibration, model=nominal, values=model.values0()))


def _diff_sides(a: _Side, b: _Side) -> VersionDiff:
    if a.robot != b.robot:
        raise ServiceError(
            f"Version {a.name} is of robot {a.robot!r}, {b.name} of {b.robot!r}: compare versions of one robot.",
            code="option_invalid",
        )
    names = [*a.values, *(name for name in b.values if name not in a.values)]
    return VersionDiff(
        a=a.name,
        b=b.name,
        effects_added=[effect for effect in b.effects if effect not in a.effects],
        effects_removed=[effect for effect in a.effects if effect not in b.effects],
        parameters=[_change(name, a, b) for name in names],
        metrics_a=a.metrics,
        metrics_b=b.metrics,
    )


def _change(name: str, a: _Side, b: _Side) -> ParameterChange:
    before, after = a.values.get(name), b.values.get(name)
    return ParameterChange(
        name=name,
        unit=(before or after or Value(0.0, "")).unit,
        a=before.value if before else None,
        b=after.value if after else None,
        change=after.value - before.value if before and after else None,
        sigma_a=a.sigma.get(name),
        sigma_b=b.sigma.get(name),
        moved=before is None
        or after is None
        or _beyond(after.value - before.value, a.sigma.get(name), b.sigma.get(name)),
    )


def _beyond(change: float, sigma_a: float | None, sigma_b: float | None) -> bool:
    """Whether a parameter moved by more than chance explains, the errors of both taken as independent."""
    return abs(change) > max(SURE * math.hypot(sigma_a or 0.0, sigma_b or 0.0), ROUNDING)


POSES_OF_INTERVAL = 3  # poses that an interval of a mean needs
EQUAL_MM = 1e-9  # smaller differences are rounding
IT = {True: "it", False: "them"}
NOTHING = "Nothing was measured at the tool in these campaigns."


@dataclass(frozen=True)
class Side:
    """A version and what people call it."""

    id: str
    name: str


@dataclass(frozen=True)
class Pairs:
    """What two versions leave of each row: the tables, the rows that both saw (``used``), and the sizes there, mm."""

    tables: tuple[Mapping[str, Any], Mapping[str, Any]]
    used: Bools
    sizes: tuple[Floats, Floats]
    held_out: bool


def pairs(database: Database, a: str, b: str, campaigns: Sequence[str]) -> Pairs:
    """Pair the rows of campaigns: those held out of both fits, or all where there are none.

    Raises:
        ServiceError: no such version or campaign, or a campaign of another robot.
        ObservationError: a campaign without a measured position.

    """
    first, second = residuals(database, a, campaigns), residuals(database, b, campaigns)
    sizes = error_lengths(first), error_lengths(second)
    seen = ~np.isnan(sizes[0]) & ~np.isnan(sizes[1])
    unseen = seen & np.asarray(first["held_out"], dtype=bool) & np.asarray(second["held_out"], dtype=bool)
    used = unseen if unseen.any() else seen
    return Pairs((first, second), used, (sizes[0][used], sizes[1][used]), bool(unseen.any()))


def judge_pairs(database: Database, found: Pairs, a: Side, b: Side) -> PairedErrors | None:
    """Say which of two versions is better; None where no row was seen."""
    if not found.used.any():
        return None
    first, second = found.sizes
    difference = first - second
    _, pose = np.unique(_poses(database, found.tables[0])[found.used], return_inverse=True)
    means = np.bincount(pose, weights=difference) / np.bincount(pose)
    better, worse = int((means > EQUAL_MM).sum()), int((means < -EQUAL_MM).sum())
    less, low, high = _interval(means)
    numbers = PairedErrors(
        campaigns=list(dict.fromkeys(found.tables[0]["campaign"].tolist())),
        held_out=found.held_out,
        rows=len(difference),
        poses=len(means),
        counted="rows" if len(means) == len(difference) else "poses",
        better=better,
        worse=worse,
        chance=chance(better, worse),
        mean_a_mm=float(first.mean()),
        mean_b_mm=float(second.mean()),
        less_mm=less,
        low_mm=low,
        high_mm=high,
        sentence="",
    )
    aside = [int(np.asarray(table["set_aside"], dtype=bool)[found.used].sum()) for table in found.tables]
    told = [sentence(numbers, a.name, b.name), *_aside(aside, (a.name, b.name))]
    return numbers.model_copy(update={"sentence": " ".join(told)})


def sentence(found: PairedErrors, a: str, b: str) -> str:
    """Say what was found, all lengths in the unit of the largest."""
    lengths = (found.mean_a_mm, found.mean_b_mm, abs(found.less_mm), found.low_mm or 0.0, found.high_mm or 0.0)
    left_a, left_b, less, low, high = said_of_lengths(max(map(abs, lengths)), *lengths)
    equal = found.poses - found.better - found.worse
    said = [
        f"On the same {found.rows} rows{', held out of both fits' if found.held_out else ''} {a} leaves {left_a} on average "
        f"and {b} {left_b}.",
        f"{b} is better on {found.better} of {found.poses} {found.counted}{f' and equal on {equal}' if equal else ''}; if "
        f"neither were better, so uneven a count would come with probability {said_of_chance(found.chance)} (exact sign "
        "test).",
        f"It leaves {less} {'less' if found.less_mm >= 0 else 'more'} on average"
        + (f" (95 % interval of how much less: {low} to {high})." if found.low_mm is not None else "."),
    ]
    if found.counted == "poses":
        said.append("Rows of one pose count once.")
    if not found.held_out:
        said.append("No row was held out of both: where one was fitted its error looks better than it is.")
    return " ".join(said)


def _aside(counts: Sequence[int], names: Sequence[str]) -> Iterator[str]:
    """Say where a version's own errors leave rows out that count here: the two numbers of it differ by that."""
    for count, name in zip(counts, names, strict=True):
        if count:
            were = "was" if count == 1 else "were"
            yield f"{count} of these rows {were} set aside by the job of {name}, whose own errors leave {IT[count == 1]} out."


def chance(better: int, worse: int) -> float:
    """Probability of at least so uneven a count where both are equally likely: exact sign test, two-sided."""
    return min(1.0, 2.0 * float(special.bdtr(min(better, worse), better + worse, 0.5)))


def residuals(database: Database, version: str, chosen: Sequence[str]) -> dict[str, Any]:
    """Return what a version leaves of every row, as the columns of the table that the interface gives, but what it expected."""
    found = left.table(database, version, chosen, expected=False)
    return {name: found.column(name).to_numpy(zero_copy_only=False) for name in found.column_names}


def error_lengths(table: Mapping[str, Any]) -> Floats:
    """Length of the errors, mm; NaN where nothing was seen."""
    return np.asarray(np.sqrt(sum(np.asarray(table[f"d{axis}_mm"], dtype=np.float64) ** 2 for axis in "xyz")))


def _interval(means: Floats) -> tuple[float, float | None, float | None]:
    mean, count = float(means.mean()), len(means)
    if count < POSES_OF_INTERVAL:
        return mean, None, None
    half = float(special.stdtrit(count - 1, 0.975) * means.std(ddof=1) / np.sqrt(count))
    return mean, mean - half, mean + half


def _poses(database: Database, table: Mapping[str, Any]) -> Ints:
    """Number the poses of all rows, those of each campaign apart."""
    found, last = [], 0
    for campaign in dict.fromkeys(table["campaign"]):
        rows = looking.load_campaign_rows(database, campaign)
        seen = observations(rows.table, rows.columns, rows.conditions)
        own = numbered_poses(seen.q) if seen.pose_id is None else np.unique(seen.pose_groups(), return_inverse=True)[1]
        found.append(own + last)
        last += int(own.max(initial=-1)) + 1
    return np.concatenate(found)
