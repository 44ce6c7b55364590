"""The gap closing step by step: the error before, with each effect, and the noise floor."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.figures import Bars, GapFigures
from kilter_service.contract.gap_details import GapSize
from kilter_service.page.figures.meanings import FITTED, HELD_OUT
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import around, category_axis
from kilter_service.page.words import number

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
