"""Two versions on the same rows, pose by pose: which one is better, by how much, and how often chance alone says so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import numbered_poses
from kilter_files.ground.later import special
from kilter_service.campaigns import looking
from kilter_service.contract.versions import PairedErrors
from kilter_service.contract.words import said_of_chance, said_of_lengths
from kilter_service.ground.db import Database
from kilter_service.ground.tables.assemble import observations
from kilter_service.versions.predictions import residuals as left

if TYPE_CHECKING:
    from kilter_core.types import Bools, Floats, Ints


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
