"""Control charts over the checks of a version: one for each number that all of them show.

What is stored of checks, and since when an arm has moved.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from kilter_service.contract.today import ControlChart
from kilter_service.ground.core import core_watch
from kilter_service.ground.limits import Recent

RUN_LENGTH = 1000  # checks between two false alarms of all charts together
FALSE_ALARM = 1e-3  # chance at which a single check alarms (kilter_core.watch, which loads numpy and scipy)
KEPT = 200  # robots whose charts are kept: some 100 kB each


class Shown(NamedTuple):
    """A number of a check, half its 95 % interval, its words and its unit."""

    value: float
    u95: float
    words: str
    unit: str


Numbers = dict[str, Shown]
SHIFTS = ("value", "x", "y", "z")  # of a frame its shift: rotations of five poses are shifts for the most part


def control_charts(made: Sequence[StoredCheck]) -> list[ControlChart]:
    """Return the charts, in the order of the causes by name, of each number that most checks show.

    A check that alarmed by itself is in no sum: it says what it saw, and after a repair the sums go on where they were. Nor is
    one that does not show the number, as of too few poses, or that states no temperature where most do.
    """
    summed_by = (
        "summed" if all(map(_has_sums, made)) else "change"
    )  # of mixed numbers the difference would look like a step
    numbers = [_numbers(one, summed_by) for one in made]
    told = Counter(name for one in numbers for name in one)
    names = sorted(name for name, count in told.items() if 2 * count > len(made))
    limit = core_watch.alarm_limit(len(names), RUN_LENGTH) if names else 0.0
    counted = _comparable(made)
    return [_chart(name, made, numbers, counted, limit) for name in names]


def _comparable(made: Sequence[StoredCheck]) -> list[int]:
    """Places of the checks that may be summed: those that agreed, by day with a temperature where most have one."""
    agreed = [k for k, one in enumerate(made) if one.result["verdict"] == "ok"]
    felt = [k for k in agreed if made[k].result.get("temperature_c") is not None]
    return felt if 2 * len(felt) > len(agreed) else agreed


def _chart(
    name: str, made: Sequence[StoredCheck], numbers: Sequence[Numbers], counted: Sequence[int], limit: float
) -> ControlChart:
    summed = [k for k in counted if name in numbers[k]]
    felt = [made[k].result.get("temperature_c") for k in summed]
    known = None if not felt or any(value is None for value in felt) else np.array(felt, dtype=np.float64)
    own = np.array([numbers[k][name].value for k in summed], dtype=np.float64)
    sure = np.array([numbers[k][name].u95 for k in summed], dtype=np.float64)
    found = core_watch.chart(own, limit, known, sure)
    first = next(one[name] for one in numbers if name in one)
    return ControlChart(
        name=name,
        words=first.words,
        unit=first.unit,
        values=[one[name].value if name in one else None for one in numbers],
        up=_sums_by_check(found.up, summed, len(made)),
        down=_sums_by_check(found.down, summed, len(made)),
        limit=limit,
        scatter=None if math.isnan(found.scatter) else found.scatter,
        alarms=found.alarms,
        since=None if found.since is None else made[summed[found.since]].at,
    )


class KeptCharts:
    """Charts of the checks that were looked at lately: computing those of a fleet takes seconds, and checks never change."""

    def __init__(self, most: int = KEPT) -> None:
        self._charts = Recent[list[ControlChart]](most)

    def get_charts(
        self, made: Sequence[StoredCheck], read: Callable[[Sequence[StoredCheck]], Sequence[StoredCheck]] | None = None
    ) -> list[ControlChart]:
        """Return the charts of these checks; what is returned is shared, and nobody changes it.

        ``read`` adds the numbers to checks whose charts are not kept.
        """
        key = tuple((one.job_id, one.at) for one in made)
        return self._charts.get(key, lambda: control_charts(made if read is None else read(made)))


def last_value(chart: ControlChart) -> float | None:
    """Return the number of the last check that shows it."""
    return next((value for value in reversed(chart.values) if value is not None), None)


def height(chart: ControlChart) -> float:
    """Return the larger sum at the last check that has one, in standard deviations."""
    return max(next((value for value in reversed(sums) if value is not None), 0.0) for sums in (chart.up, chart.down))


def _has_sums(one: StoredCheck) -> bool:
    """Whether a check was stored with the numbers that are to be summed; an earlier release had the changes alone."""
    return all(
        number.get("summed") is not None for cause in one.result.get("looked_at") or [] for number in cause["numbers"]
    )


def _numbers(one: StoredCheck, summed_by: str) -> Numbers:
    """Every number that a check shows, by name."""
    found: Numbers = {}
    for cause in one.result.get("looked_at") or []:
        for number in cause["numbers"]:
            if number["name"] in SHIFTS and number["u95"] is not None:
                named = "" if number["name"] == "value" else f"_{number['name']}"
                along = f" along {number['name']}" if named else ""
                own = number.get("summed_u95") if summed_by == "summed" else None
                value, u95 = float(number[summed_by]), float(own or number["u95"])
                found[cause["name"] + named] = Shown(value, u95, f"{cause['words']}{along}", number["unit"])
    return found


def _sums_by_check(sums: Any, places: Sequence[int], count: int) -> list[float | None]:
    out: list[float | None] = [None] * count
    for place, value in zip(places, sums, strict=True):
        out[place] = None if np.isnan(value) else float(value)
    return out


SIX = 1.35  # of a 95 % half width is that of six numbers together
COARSER = 1.5  # times the noise of a check that then says nothing of what no single cause explains


@dataclass(frozen=True)
class StoredCheck:
    """A check that was made, and when its rows were measured, or sent.

    ``whole``: every cause was looked at. Where frames were set up anew, or places were not measured, it says how the arm
    stands, and is in no sum.
    """

    job_id: str
    campaign_id: str
    at: datetime
    result: Mapping[str, Any]
    whole: bool = True


@dataclass(frozen=True)
class Activated:
    """An entry of the log of active versions; ``rezeroed``: a version of what moved."""

    version_id: str
    at: datetime
    action: str
    rezeroed: bool


# Since when an arm has moved: the day of the last check that showed what changed as it was before.
# A check that agreed may have seen less than the one that alarmed: by fewer poses, by a coarser instrument, or of a
# change that came little by little. It says nothing of when, so the one before it counts.


def last_otherwise(
    causes: Sequence[Mapping[str, Any]], noise_mm: float, poses: int, agreeing: Iterable[StoredCheck]
) -> datetime | None:
    """When a check last showed every one of the causes that may be it otherwise than now; None: none did.

    ``causes`` are documents; where there are none, a check counts that saw as much as the one with ``noise_mm`` and ``poses``.
    """
    for one in sorted(agreeing, key=lambda one: one.at, reverse=True):
        before = {each["name"]: each for each in one.result.get("looked_at") or []}
        if causes:
            shown = all(_differs(cause, before.get(cause["name"])) for cause in causes)
        else:
            shown = _saw_as_much(one.result, noise_mm, poses)
        if shown:
            return one.at
    return None


def _differs(now: Mapping[str, Any], before: Mapping[str, Any] | None) -> bool:
    """Whether some number of a cause is beyond what both checks leave open of it."""
    was = {number["name"]: number for number in (before or {}).get("numbers") or []}
    wider = 1.0 if len(now["numbers"]) == 1 else SIX
    for number in now["numbers"]:
        other = was.get(number["name"])
        if other is None or other["u95"] is None or number["u95"] is None:
            continue
        if abs(number["change"] - other["change"]) > wider * math.hypot(number["u95"], other["u95"]):
            return True
    return False


def _saw_as_much(result: Mapping[str, Any], noise_mm: float, poses: int) -> bool:
    noise, count = result.get("noise_mm"), result.get("poses")
    return noise is None or count is None or (noise <= COARSER * noise_mm and count >= poses)
