"""Two versions side by side: the parameters that differ, and what each leaves of the same rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.versions import PairedErrors, ParameterChange, Version, VersionDiff
from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import around, category_axis, lengths
from kilter_service.page.versions.paired import maps
from kilter_service.page.words import in_columns
from kilter_service.versions import service
from kilter_service.versions.predictions import differences

MOST_CAMPAIGNS, MOST_VERSIONS = 20, 12
MOST_AT_ONCE = 5000  # rows that are paired before the view is sent: 0.15 s of processor
SAME = 1e-9  # smaller differences are rounding
STEPS = 200  # of a cumulative curve
BARS = ("mean_mm", "p95_mm", "max_mm")
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
        return dict(zip(BARS, found, strict=True))


@dataclass(frozen=True)
class Compared:
    """Two versions, the campaigns to choose from, and what was found on those that were chosen."""

    robot: str
    a: Version | None
    b: Version | None
    diff: VersionDiff
    changed: Sequence[ParameterChange]
    campaigns: Sequence[Campaign]
    chosen: Sequence[str]
    left: Sequence[Left]
    bars: Plot | None
    curve: Plot | None
    maps: Sequence[Plot]

    @property
    def paired(self) -> PairedErrors | None:
        """What both leave of the same rows."""
        return self.diff.paired

    @property
    def later(self) -> int:
        """How many rows are paired only when the view has asked for them; 0 where all is said."""
        if self.diff.paired is not None or self.diff.not_paired:
            return 0
        return sum(one.rows for one in self.campaigns if one.id in self.chosen)

    @property
    def moved(self) -> list[ParameterChange]:
        """Parameters that differ by more than their uncertainty, or are in one version only."""
        return [one for one in self.changed if one.moved]

    @property
    def within(self) -> list[ParameterChange]:
        """The others that differ."""
        return [one for one in self.changed if not one.moved]

    @property
    def same(self) -> int:
        """How many parameters do not differ."""
        return len(self.diff.parameters) - len(self.changed)


def compared_versions(database: Database, a: str, b: str, wanted: Sequence[str] | None, whole: bool = True) -> Compared:
    """Compare two versions on rows held out of both, where there are such; many rows only for the ``whole``."""

    def few(chosen: Sequence[str]) -> bool:
        robot = service.get(database, differences.resolve_version_id(a)).robot
        there = campaigns.list_campaigns(database, robot, Page()).campaigns
        return sum(one.rows for one in there if one.id in chosen) <= MOST_AT_ONCE

    found = differences.compare_versions(database, a, b, wanted or (), None if whole else few)
    diff, rows = found.diff, found.pairs
    sides = [None if name == differences.NOMINAL else service.get(database, name) for name in (diff.a, diff.b)]
    known = next(side for side in sides if side is not None)
    there = [one for one in campaigns.list_campaigns(database, known.robot, Page()).campaigns if one.rows]
    names = [title(side) for side in sides if side is not None]
    left = [] if rows is None else [Left(n, sizes.tolist()) for n, sizes in zip(names, rows.sizes, strict=True)]
    bars, curve = (None, None) if not left else (_bars(left), _curve(left))
    changed = [one for one in diff.parameters if one.change is None or abs(one.change) > SAME]
    drawn = [] if rows is None else maps(database, rows, names, diff.b)
    return Compared(known.robot, sides[0], sides[1], diff, changed, there, found.campaigns, left, bars, curve, drawn)


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
    rest = [(one, compared_versions(database, first.id, one.id, usual.chosen, whole)) for one in others]
    return [(first, None), (second, usual), *rest]


def title(version: Version) -> str:
    """Return what a version is called in a picture."""
    return display_name(version)


def _bars(left: Sequence[Left]) -> Plot:
    names = [MEASURES[measure] for measure in BARS]
    values = [[one.numbers[measure] for measure in BARS] for one in left]
    unit, sizes = in_columns(list(zip(*values, strict=True)))
    drawn = Plot(
        "Errors on the same rows",
        category_axis("", names),
        lengths("error", [v for row in values for v in row], zero=True),
        height=280.0,
        description="Mean, 95th percentile and largest error of each version on the rows chosen.",
        table=(
            [f"error, {unit}", *(one.name for one in left)],
            [[name, *row] for name, row in zip(names, sizes, strict=True)],
        ),
    )
    width = 0.7 / len(left)
    for number, (one, row) in enumerate(zip(left, values, strict=True)):
        places = [k + 0.5 + (number - (len(left) - 1) / 2) * width for k in range(len(BARS))]
        drawn.bars(places, row, 0.9 * width, one.name, number)
    return drawn


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
