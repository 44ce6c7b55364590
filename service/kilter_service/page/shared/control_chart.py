"""The checks of a robot over the days: what each said by itself, and the sums that see what creeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

from kilter_service.contract.today import CheckOfRobot, ControlChart, DriftHistory, DriftMark, DriftSummary, Today
from kilter_service.ground.naming import plural
from kilter_service.page.figures.plot import GREY, Axis, Days, Plot, days_around, lengths
from kilter_service.page.words import bare, format_in_largest_unit, moment, number, unit
from kilter_service.versions.drift.wire import chance_words, height, last_value
from kilter_service.versions.today.standing import ago

DAY = 86400.0
WIDTH, HEIGHT = 480.0, 280.0  # two beside each other, and one on a telephone whose letters can be read
WIDE, LOW = 1340.0, 138.0  # of the errors over time
SHOWN_SUMS = 4  # of the charts, those with the largest sums
FAR, FAR_DAYS = 5.0, 60.0  # a gap in the dates of so many times what follows, and so many days, is left out
NEVER_SUMMED = (
    "No sums: with frames set up anew, or by a joint log alone, a check does not show every cause, and what creeps is not "
    "seen. Leave the instrument where it stands for some checks."
)
MARKS = ("activated", "re-zeroed", "rolled back", "repaired", "repair", "note")


@dataclass(frozen=True)
class Watched:
    """The figures of a robot's checks: ``errors`` None where there are none, ``sums`` None where they are too few.

    ``begins`` says what is dated so long before that it is not drawn; empty where all is.
    """

    found: DriftHistory
    errors: Plot | None
    sums: Plot | None
    begins: str = ""

    @property
    def no_sums(self) -> str:
        """Why there are none yet, or never will be."""
        own = [one for one in self.found.history if one.version_id == self.found.version_id]
        if own and not any(one.whole for one in own):
            return NEVER_SUMMED
        return "The sums over many checks begin with the fourth that agrees."

    @property
    def standing(self) -> str:
        """When the last check was."""
        return standing(self.found)

    @property
    def repairs(self) -> list[DriftMark]:
        """What somebody recorded that was done to the arm, and their notes, the newest first."""
        return [one for one in reversed(self.found.marks) if one.what in ("repair", "note")]


def standing(found: DriftSummary) -> str:
    """Say when the last check was, after the sentence of the state."""
    if found.last is None or found.age_days is None:
        return ""
    checks = plural(found.checks, "check")
    return f"Checked on {found.last.at:%Y-%m-%d}, {ago(found.age_days)}; {checks} of this version."


def draw_check_history(found: DriftHistory, today: Today) -> Watched:
    """Draw the errors and the checks of a robot."""
    days = [_day(one.at) for one in found.history] + [_day(one.at) for one in today.history]
    if not days:
        return Watched(found, None, None)
    days += [_day(one.at) for one in found.marks]
    first = _first_drawn(days)
    axis = days_around("", [day for day in days if day >= first])
    return Watched(found, _errors(found, today, axis), _sums(found, axis), _said_of_the_left(found, first))


def _first_drawn(days: Sequence[float]) -> float:
    """The day on which the figures begin: a few dates long before all others would squeeze these into a line."""
    sorted_days = sorted(days)
    gaps = [after - before for before, after in pairwise(sorted_days)]
    if not gaps:
        return sorted_days[0]
    place = max(range(len(gaps)), key=gaps.__getitem__)
    lasts = sorted_days[-1] - sorted_days[place + 1]
    few = place + 1 < 0.5 * len(sorted_days)
    far = gaps[place] > max(FAR * lasts, FAR_DAYS)
    return sorted_days[place + 1] if few and far else sorted_days[0]


def _said_of_the_left(found: DriftHistory, first: float) -> str:
    left = [one.at for one in found.history if _day(one.at) < first]
    left += [one.at for one in found.marks if _day(one.at) < first]
    if not left:
        return ""
    days = f"{min(left):%Y-%m-%d}"
    if min(left).date() != max(left).date():
        days = f"{plural(len(left), 'date')} from {days} to {max(left):%Y-%m-%d}"
    return (
        f"Not drawn: {days}, long before all others; the table has it. Where a date is wrong, as of a clock "
        "that was set back, retire that campaign and check again with the right date."
    )


def _drawn(axis: Days, at: datetime) -> bool:
    return _day(at) >= axis.low


def _errors(found: DriftHistory, today: Today, axis: Days) -> Plot | None:
    """The mean error on rows that no fit used, with its interval, over the days; a dot leads to its rows."""
    errors = [one for one in today.history if _drawn(axis, one.at)]
    if not errors:
        return None
    tolerance = today.standing.tolerance_mm if today.standing is not None else None
    ends = [end for one in errors for end in (one.low_mm, one.high_mm) if end]
    every = [*(one.mean_mm for one in errors), *ends, *([tolerance] if tolerance is not None else [])]
    across = lengths("mean error", every, log=True)
    said = {one.job_id: f"{one.sentence} " for one in found.history if one.verdict != "ok"}
    alarmed = sum(one.verdict != "ok" for one in found.history)
    about = f"{len(found.history)} checks, of which {alarmed} alarmed. {found.sentence}"
    drawn = Plot("Error over time", axis, across, WIDE, LOW, description=about, table=_table(found, today))
    _mark_events(drawn, found, axis)
    for one in errors:
        if one.low_mm and one.high_mm:
            drawn.line([_day(one.at)] * 2, [one.low_mm, one.high_mm], colour=GREY)
    for label, look, chosen in (
        ("evaluation", 2, ("evaluation", False)),
        ("check", 0, ("check", False)),
        ("check that alarmed", 4, ("check", True)),
    ):
        own = [one for one in errors if (one.source, one.alarm) == chosen]
        if own:
            words = [
                f"{one.at:%Y-%m-%d}: {said.get(one.job_id, '')}{format_in_largest_unit(one.mean_mm, one.high_mm)}"
                for one in own
            ]
            links = [f"?version={one.version_id}&campaign={one.campaign_id}#arm" for one in own]
            days, means = [_day(one.at) for one in own], [one.mean_mm for one in own]
            drawn.points(days, means, label, look, names=words, links=links)
    return drawn if tolerance is None else drawn.level(tolerance, f"tolerance {tolerance:g} mm")


def _sums(found: DriftHistory, axis: Days) -> Plot | None:
    """The largest cumulative sums of the active version."""
    summed = sorted((one for one in found.charts if _heights(one)), key=height, reverse=True)
    if not summed:
        return None
    charts = summed[:SHOWN_SUMS]
    days = [
        _day(one.at)
        for one in found.history
        if one.whole
        and one.version_id == found.version_id
        and (found.repaired_at is None or one.at >= found.repaired_at)
    ]
    highest = max([charts[0].limit, *(max(_heights(one)) for one in charts)])
    drawn = Plot(
        "Cumulative sums",
        axis,
        Axis("sum, standard deviations of a check", 0.0, 1.08 * highest),
        WIDTH,
        HEIGHT,
        description=_said_of_sums(charts),
        table=_sums_table(summed),
    )
    _mark_events(drawn, found, axis, labelled=False)
    for place, one in enumerate(charts):
        sums = [_higher(up, down) for up, down in zip(one.up, one.down, strict=True)]
        there = [
            (day, value) for day, value in zip(days, sums, strict=True) if math.isfinite(value) and day >= axis.low
        ]
        drawn.line([day for day, _ in there], [value for _, value in there], one.words, place)
    return drawn.level(charts[0].limit, f"alarm: all together 1 of {found.run_length} checks")


def _mark_events(drawn: Plot, found: DriftHistory, axis: Days, labelled: bool = True) -> None:
    for place, what in enumerate(MARKS):
        own = [one for one in found.marks if one.what == what and _drawn(axis, one.at)]
        names = [f"{what} {moment(one.at)}: {one.note or one.version_id}" for one in own]
        drawn.uprights([_day(one.at) for one in own], what if labelled else "", place + 1, names)


def _day(at: datetime) -> float:
    return at.timestamp() / DAY


def _higher(up: float | None, down: float | None) -> float:
    return math.nan if up is None or down is None else max(up, down)


def _heights(chart: ControlChart) -> list[float]:
    found = [_higher(up, down) for up, down in zip(chart.up, chart.down, strict=True)]
    return [one for one in found if math.isfinite(one)]


def _said_of_sums(charts: Sequence[ControlChart]) -> str:
    most = charts[0]
    beyond = "beyond" if most.alarms else "below"
    return (
        f"The largest sum is that of {most.words}: {number(height(most))}, {beyond} the limit of {number(most.limit)}."
    )


def _table(found: DriftHistory, today: Today) -> tuple[list[str], list[list[str]]]:
    errors = {one.job_id: one for one in today.history}
    most = max((one.mean_mm for one in today.history), default=None)
    rows = [
        (
            one.at,
            [
                _when(one.at),
                _words(one),
                chance_words(one.p_value, 2),
                bare(seen.mean_mm if (seen := errors.pop(one.job_id, None)) else None, most),
            ],
        )
        for one in found.history
    ]
    rows += [(one.at, [_when(one.at), "evaluation", "", bare(one.mean_mm, most)]) for one in errors.values()]
    rows += [(one.at, [_when(one.at), f"{one.what}: {one.note or one.version_id}", "", ""]) for one in found.marks]
    head = ["When", "What", "Chance", f"Mean error, {unit(most)}"]
    return head, [row for _, row in sorted(rows, key=lambda one: one[0], reverse=True)]


def _when(at: datetime) -> str:
    return f"{at:%Y-%m-%d %H:%M}"


def _words(one: CheckOfRobot) -> str:
    if one.verdict != "ok":
        return one.sentence
    return "ok" if one.whole else "ok, by rows that do not show every cause"


def _sums_table(charts: Sequence[ControlChart]) -> tuple[list[str], list[list[str]]]:
    rows = [
        [
            one.words,
            f"{number(last_value(one))} {one.unit}",
            f"{number(one.scatter)} {one.unit}",
            number(height(one)),
            "" if one.since is None else f"{one.since:%Y-%m-%d}",
        ]
        for one in charts
    ]
    return ["Of", "Last check", "Scatter", "Sum", "Since"], rows
