"""Errors as figures: by model, by share of the rows, by effect, and step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from kilter_service.contract.figures import Bars, GapFigures, PlaneFigure, Scatter
from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.contract.gap_details import GapSize
from kilter_service.ground.db import Database
from kilter_service.page.figures.plot import FITTED, HELD_OUT, Plot, Table, around, category_axis, lengths
from kilter_service.page.words import in_columns, in_one_unit, number
from kilter_service.versions.predictions.at_pose import contributions

if TYPE_CHECKING:
    from kilter_core.types import Floats, Ints
    from kilter_service.versions.predictions.at_pose import Contribution


Series = tuple[str, str, Sequence[float | None]]  # of one look: label, colour (empty: the next), values


def grouped_bars(
    title: str,
    names: Sequence[str],
    series: Sequence[Series],
    *,
    what: str = "error",
    across: str = "",
    size: tuple[float, float] = (640.0, 320.0),
    log: bool = False,
    description: str = "",
    table: Table | None = None,
    errors: Sequence[tuple[float, float]] = (),
) -> Plot:
    """Draw lengths, mm, as bars beside each other at each name, by default with their table; ``errors`` are of one series."""
    shown = [value for _, _, row in series for value in row if value is not None] + [
        end for pair in errors for end in pair
    ]
    axis = lengths(what, shown, zero=not log, log=log)
    if table is None:
        unit, sizes = in_columns(list(zip(*(row for _, _, row in series), strict=True)))
        head = [across, *(f"{label}, {unit}" for label, _, _ in series)]
        table = (head, [[name, *row] for name, row in zip(names, sizes, strict=True)])
    drawn = Plot(title, category_axis(across, names), axis, *size, description, table)
    width = 0.8 / len(series) if len(series) > 1 else 0.6
    for k, (label, colour, row) in enumerate(series):
        there = [(n + 0.5 + (k - (len(series) - 1) / 2) * width, one) for n, one in enumerate(row) if one is not None]
        drawn.bars([x for x, _ in there], [one for _, one in there], 0.92 * width, label, k, colour, errors)
    return drawn


MOST_DRAWN, LARGEST = 1200, 200  # rows that are drawn, and how many of them are the largest
STAGES = (
    ("nominal", "Before"),
    ("registration_only", "Registration only"),
    ("geometry_fitted", "Geometry alone"),
    ("without_effects", "Without its effects"),
    ("identified", "After"),
)
BARS = (("mean_mm", "mean"), ("rms_mm", "rms"), ("p95_mm", "95 % are below"))
CURVES = {"before, nominal": "Before", "registration only": "Registration only", "identified": "After"}
PLACED = "Nominal, mostly where instrument, base and tool are"
ALONE = {"Geometry alone", "Without its effects"}
EARLIER = "Geometry only"  # either of them, as an earlier release stored it
NO_OTHER: Mapping[str, str] = {}
MEANING = {
    "Before": "the nominal robot, where it is said to stand",
    PLACED: "no version takes this away, and it is not an error of the arm",
    "Registration only": "the nominal robot, base and tool fitted to the rows: what comes from the set-up alone is gone",
    "Geometry alone": "the geometry fitted to the same rows without effects: the best rigid arm",
    "Without its effects": "its geometry as it is, what bends and gives left out, as in a file of geometry alone",
    EARLIER: "the geometry without effects",
    "After": "the model that was identified",
}


def rows_to_draw(sizes: Floats) -> Ints:
    """Return the places of rows that are drawn: all, or some evenly chosen and those with the largest sizes."""
    if len(sizes) <= MOST_DRAWN:
        return np.arange(len(sizes))
    even = np.linspace(0, len(sizes) - 1, MOST_DRAWN - LARGEST).astype(np.int64)
    return np.union1d(even, np.argsort(-sizes)[:LARGEST])


def compared_models(errors: StageErrors | None, other: Mapping[str, str] = NO_OTHER) -> list[tuple[str, Errors]]:
    """Return the models that were compared, in the order of what they know; ``other`` renames some."""
    placed = errors is not None and errors.place_mm is not None
    named = [(name, PLACED if placed and name == "nominal" else other.get(title, title)) for name, title in STAGES]
    found = [(title, getattr(errors, name, None)) for name, title in named]
    if not {title for title, one in found if one is not None} & ALONE:
        found.insert(-1, (EARLIER, getattr(errors, "geometry_only", None)))
    return [(title, one) for title, one in found if one is not None]


def bars(errors: StageErrors | None, where: str, other: Mapping[str, str] = NO_OTHER) -> Plot | None:
    """Draw a bar for each model; None: nothing was measured."""
    # Beside what the set-up does all others would be as good as zero.
    stages = [one for one in compared_models(errors, other) if one[0] != PLACED]
    if not stages:
        return None
    series = [(label, "", [getattr(one, name) for _, one in stages]) for name, label in BARS]
    sizes = in_one_unit([[one.mean_mm] for _, one in stages])
    said = "; ".join(f"{title}: mean {mean}" for (title, _), (mean,) in zip(stages, sizes, strict=True))
    names, numbers = [title for title, _ in stages], table(errors, other)
    return grouped_bars(f"Errors of the tool on {where}", names, series, description=said, table=numbers)


def table(errors: StageErrors | None, other: Mapping[str, str] = NO_OTHER) -> tuple[list[str], list[list[str]]]:
    """Return the same numbers in words."""
    found = compared_models(errors, other)
    unit, sizes = in_columns([[one.mean_mm, one.rms_mm, one.p95_mm, one.max_mm] for _, one in found])
    rows = [[title, *row] for (title, _), row in zip(found, sizes, strict=True)]
    return ["Model", *(f"{name}, {unit}" for name in ("Mean", "Rms", "95 % are below", "Largest"))], rows


def cumulative(
    figure: PlaneFigure | None, where: str, names: Mapping[str, str], colour: str = "", height: float = 320.0
) -> Plot | None:
    """Draw a curve for each model, told apart by its dashes, the last one solid; None: there is no histogram.

    ``names`` says what the models of the histogram are called here, ``colour`` is that of all curves (empty: one each).
    """
    traces = [
        (names.get(short := (one.name or "").partition(":")[0], short), *_shares(one))  # behind a colon it has numbers
        for one in (figure.data or [] if figure is not None else [])
    ]
    traces = [one for one in traces if one[1]]
    if not traces:
        return None
    halves = [next(x for x, y in zip(xs, ys, strict=True) if y >= 50.0 - 1e-9) for _, xs, ys in traces]
    unit, errors = in_columns([[half, xs[-1]] for half, (_, xs, _) in zip(halves, traces, strict=True)])
    plot = Plot(
        f"Share of {where} with at most an error",
        lengths("error", [x for one in traces for x in one[1]], log=True),
        around("share of rows, %", [0.0, 100.0], zero=True),
        height=height,
        description="The further left a curve rises, the smaller the errors.",
        table=(
            ["Model", f"Half of the rows are below, {unit}", f"All are below, {unit}"],
            [[one[0], *row] for one, row in zip(traces, errors, strict=True)],
        ),
    )
    for place, (name, xs, ys) in enumerate(traces):
        plot.line(xs, ys, name, len(traces) - 1 - place, colour)
    return plot


def _shares(trace: Scatter) -> tuple[list[float], list[float]]:
    """Return errors and the share of rows below each, from counts per bin: each is given with its lower edge."""
    edges = [float(x) for x in trace.x if isinstance(x, int | float)]
    counts = [y or 0.0 for y in trace.y]
    total = sum(counts)
    if not total or len(edges) != len(counts):
        return [], []
    shares = [100.0 * share / total for share in accumulate(counts)]
    first = next(k for k, share in enumerate(shares) if share > 0)
    last = next(k for k, share in enumerate(shares) if share >= 100.0 - 1e-9)
    return edges[first : last + 2], [0.0, *shares[first : last + 1]]


COLOURS = ("", "")  # those of plots


@dataclass(frozen=True)
class Moved:
    """The effects that move the tool at ``poses`` within the joint limits, the largest first.

    ``elsewhere`` are those that act only with what such poses do not state.
    """

    poses: int
    effects: Sequence[Contribution]
    elsewhere: Sequence[str]

    def plot(self, colours: tuple[str, str] = COLOURS, width: float = 640.0) -> Plot:
        """Draw rms and largest movement."""
        labels = (("rms", colours[0]), ("largest", colours[1]))
        return grouped_bars(
            "Movement of the tool by each effect",
            [one.effect for one in self.effects],
            [(label, colour, [getattr(one, f"{label}_mm") for one in self.effects]) for label, colour in labels],
            what="movement",
            size=(width, 260.0),
            description="Two bars for each effect: root mean square and largest movement of the tool.",
        )


def moved_by_each(database: Database, version_id: str) -> Moved:
    """Say how far each effect of a version moves the tool."""
    poses, found = contributions(database, version_id)
    return Moved(
        poses, [one for one in found if one.rms_mm is not None], [one.effect for one in found if one.rms_mm is None]
    )


WIDTH = 0.34


@dataclass(frozen=True)
class Step:
    """The error that is left at one step; ``low`` and ``high`` are the ends of the held-out error's interval."""

    label: str
    fitted: float
    held_out: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Steps:
    """All steps, and what noise alone would leave."""

    steps: list[Step]
    noise: Step
    unit: str


def error_unit(gap: GapSize | None) -> str:
    """Return the unit of the errors: joint data have degrees, and views lengths of their own."""
    if gap is not None and gap.lengths == "by_views":
        return "mm by views"
    return "deg" if gap is not None and gap.before_deg is not None else "mm"


def steps_shown(figures: GapFigures | None, unit: str) -> Steps | None:
    """Read the steps from the report's figure; None where it has none."""
    bars = figures.gap_bar.data if figures is not None and figures.gap_bar is not None else None
    if not bars or len(bars[0].x) < 2:
        return None
    read = [_step(bars, place) for place in range(len(bars[0].x))]
    return Steps(read[:-1], read[-1], unit)


def _step(bars: list[Bars], place: int) -> Step:
    label, fitted = str(bars[0].y[place]), _number(bars[0].x[place])
    if len(bars) < 2:
        return Step(label, fitted or 0.0)
    held, error = _number(bars[1].x[place]), bars[1].error_x
    above = error.array[place] if error is not None else None
    below = error.arrayminus[place] if error is not None and error.arrayminus is not None else None
    if held is None or not above or not below:  # the noise has no interval
        return Step(label, fitted or 0.0, held)
    return Step(label, fitted or 0.0, held, held - below, held + above)


def _number(value: float | str | None) -> float | None:
    return float(value) if isinstance(value, float | int) else None


def plot(read: Steps, colours: tuple[str, str] = (FITTED, HELD_OUT)) -> Plot:
    """Draw the steps as bars with intervals, and the noise as a line."""
    held = [step.held_out for step in read.steps if step.held_out is not None]
    floor = read.noise.held_out if read.noise.held_out is not None else read.noise.fitted
    values = [step.fitted for step in read.steps] + held + [floor] + [s.high for s in read.steps if s.high is not None]
    drawn = Plot(
        "The gap closing step by step",
        category_axis("", [step.label for step in read.steps]),
        around(f"rms error, {read.unit}", values, zero=True),
        height=340.0,
        table=_table(read),
        description=describe(read),
    )
    shift = WIDTH / 2 if held else 0.0
    places = [place + 0.5 for place in range(len(read.steps))]
    drawn.bars(
        [p - shift for p in places], [s.fitted for s in read.steps], WIDTH, "poses that were fitted", colour=colours[0]
    )
    if held:
        ends = [(s.low, s.high) for s in read.steps if s.low is not None and s.high is not None]
        errors = ends if len(ends) == len(read.steps) else []
        label = f"held-out poses{', with 95 % intervals' if errors else ''}"
        drawn.bars([p + shift for p in places], held, WIDTH, label, colour=colours[1], errors=errors)
    return drawn.level(floor, f"what noise alone would leave{' of held-out poses' if held else ''}")


def describe(read: Steps) -> str:
    """Say in a sentence how far the gap closes."""
    first, last, noise = read.steps[0], read.steps[-1], read.noise
    if first.held_out is not None and last.held_out is not None:
        return (
            f"On held-out poses the error falls from {number(first.held_out)} to {number(last.held_out)} {read.unit}; "
            f"noise alone would leave {number(noise.held_out)} {read.unit}."
        )
    return (
        f"On the poses that were fitted the error falls from {number(first.fitted)} to {number(last.fitted)} {read.unit}; "
        f"noise alone would leave {number(noise.fitted)} {read.unit}. No pose was held out of the search."
    )


def _table(read: Steps) -> tuple[list[str], list[list[str]]]:
    head = ["Step", f"Fitted poses, {read.unit}", f"Held-out poses, {read.unit}", "95 % interval"]
    rows = [
        [
            step.label,
            number(step.fitted),
            number(step.held_out),
            "–" if step.low is None else f"{number(step.low)} to {number(step.high)}",
        ]
        for step in [*read.steps, read.noise]
    ]
    shown = 2 if all(step.held_out is None for step in read.steps) else len(head)
    return head[:shown], [row[:shown] for row in rows]
