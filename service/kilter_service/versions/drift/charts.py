"""Control charts over the checks of a version: one for each number that all of them show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from kilter_service.contract.drift import ControlChart
from kilter_service.ground.core import core_history
from kilter_service.ground.recent import Recent
from kilter_service.versions.drift.records import StoredCheck

RUN_LENGTH = 1000  # checks between two false alarms of all charts together
FALSE_ALARM = 1e-3  # chance at which a single check alarms (kilter_core.watch, which loads numpy and scipy)
KEPT = 200  # robots whose charts are kept: some 100 kB each
SHIFTS = ("value", "x", "y", "z")  # of a frame its shift: rotations of five poses are shifts for the most part


def charts_of(made: Sequence[StoredCheck]) -> list[ControlChart]:
    """Return the charts, in the order of the first check's causes by name; a number that some check does not show has none.

    A check that alarmed by itself is in no sum: it says what it saw, and after a repair the sums go on where they were.
    """
    summed_by = (
        "summed" if all(map(_has_sums, made)) else "change"
    )  # of mixed numbers the difference would look like a step
    numbers = [_numbers(one, summed_by) for one in made]
    names = sorted(set.intersection(*map(set, numbers))) if numbers else []
    if not names:
        return []
    limit = core_history.alarm_limit(len(names), RUN_LENGTH)
    summed = [k for k, one in enumerate(made) if one.result["verdict"] == "ok"]
    felt = [made[k].result.get("temperature_c") for k in summed]
    known = None if not felt or any(value is None for value in felt) else np.array(felt, dtype=np.float64)
    out = []
    for name in names:
        values = np.array([one[name][0] for one in numbers])
        found = core_history.chart(values[summed], limit, known)
        words, unit = numbers[0][name][1:]
        out.append(
            ControlChart(
                name=name,
                words=words,
                unit=unit,
                values=values.tolist(),
                up=_sums_by_check(found.up, summed, len(made)),
                down=_sums_by_check(found.down, summed, len(made)),
                limit=limit,
                scatter=None if math.isnan(found.scatter) else found.scatter,
                alarms=found.alarms,
                since=None if found.since is None else made[summed[found.since]].at,
            )
        )
    return out


class KeptCharts:
    """Charts of the checks that were looked at lately: computing those of a fleet takes seconds, and checks never change."""

    def __init__(self, most: int = KEPT) -> None:
        self._charts = Recent[list[ControlChart]](most)

    def of(self, made: Sequence[StoredCheck]) -> list[ControlChart]:
        """Return the charts of these checks; what is returned is shared, and nobody changes it."""
        return self._charts.get(tuple((one.job_id, one.at) for one in made), lambda: charts_of(made))


def height(chart: ControlChart) -> float:
    """Return the larger sum at the last check that has one, in standard deviations."""
    return max(next((value for value in reversed(sums) if value is not None), 0.0) for sums in (chart.up, chart.down))


def _has_sums(one: StoredCheck) -> bool:
    """Whether a check was stored with the numbers that are to be summed; an earlier release had the changes alone."""
    return all(
        number.get("summed") is not None for cause in one.result.get("looked_at") or [] for number in cause["numbers"]
    )


def _numbers(one: StoredCheck, summed_by: str) -> dict[str, tuple[float, str, str]]:
    """Change, words and unit by name of every number that a check shows."""
    found: dict[str, tuple[float, str, str]] = {}
    for cause in one.result.get("looked_at") or []:
        for number in cause["numbers"]:
            if number["name"] in SHIFTS and number["u95"] is not None:
                named = "" if number["name"] == "value" else f"_{number['name']}"
                along = f" along {number['name']}" if named else ""
                found[cause["name"] + named] = (float(number[summed_by]), f"{cause['words']}{along}", number["unit"])
    return found


def _sums_by_check(sums: Any, places: Sequence[int], count: int) -> list[float | None]:
    out: list[float | None] = [None] * count
    for place, value in zip(places, sums, strict=True):
        out[place] = None if np.isnan(value) else float(value)
    return out
