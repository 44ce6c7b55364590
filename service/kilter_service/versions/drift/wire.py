"""What a check of an arm says, in words and in the units of the wire.

Control charts over the checks of a version: one for each number that all of them show.

What is stored of checks, and since when an arm has moved.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kilter_service.contract.today import ControlChart
from kilter_service.ground.core import core_watch
from kilter_service.ground.limits import Recent
from kilter_service.ground.wire import DEG, MM, to_mm

if TYPE_CHECKING:
    from kilter_core.watch import Cause, Check, Faint, Judged, Rezeroed


PPM = 1e6
QUANTILE = 1.959963984540054  # of a 95 % interval (kilter_core.types, which loads numpy)
LEAST_CHANCE = 1e-6
ZERO, SLIDE = math.radians(0.03), 5e-5  # steps that a check should show (kilter_core.watch.poses, which loads scipy)
FRAME = ("x", "y", "z", "rx", "ry", "rz")
KINDS = {"zero": "zero of joint {}", "sag": "sag of joint {}", "base": "base", "tool": "tool", "scale": "scale"}
MORE_POSES = "Measure more poses that differ in every joint, far from each other, and check again."
MASTERING = (
    "No measurement on the tool tells them apart. Look at the mastering marks of joint {joint} and at {place}, or measure "
    "targets on {thing} with the instrument."
)
SEARCH = (
    "Measure a campaign of 40 poses or more and search it (kilter gap --start VERSION): several things have changed, or one "
    "that a check does not know."
)
MOVED = (
    "Repair it and check again; or make a version of what moved (kilter watch rezero), or identify one anew. Until "
    "then the version "
    "corrects an arm that is no longer there."
)
SCATTER = 1.5  # times as much as expected, from which it is said that the rows scatter more
STATE_WARMTH = "State temperature_c of these rows and of those of the fit, and check again. Else: "
INSTRUMENT = (
    "No parameter of the arm is such a change, and nothing can be re-zeroed. Check the instrument with a known length (its "
    "unit, its refractive index), and whether the arm is as warm as when the version was measured; state temperature_c of both."
)
NO_NUMBER = (
    "Repair it and check again. The version has no number for it that a re-zeroing could change: identify one anew with "
    "axial_compliance at that joint. Look first whether the rows carried the payload that was stated."
)
LOADED = "Where the rows carried another payload than was stated, state it (payload_kg) and check again. Else: "
ANEW = {
    "base": "Where the instrument was set up anew, check again and say so (--new-setup base). Else: ",
    "tool": "Where another tool was mounted, check again and say so (--new-setup base,tool). Else: ",
}


DATED_BEFORE = {
    "dated_before_last_check": "before the last check of this version ({other:%Y-%m-%d %H:%M}). It stands at its date in the "
    "history, and the later check says how the arm stands",
    "dated_before_fit": "before rows that the version was fitted to ({other:%Y-%m-%d %H:%M}): it says how the arm was then",
}


def dated_before(code: str, campaign: str, at: datetime, other: datetime) -> str:
    """Say that rows are dated before what they should come after, and what to do where the date is wrong."""
    return (
        f"Campaign {campaign} is dated {at:%Y-%m-%d %H:%M}, {DATED_BEFORE[code].format(other=other)}. If the date is wrong, "
        f"as of a clock that was set back, retire it (`kilter measure campaigns retire {campaign}`) and check again "
        "with the right "
        "--measured-at."
    )


def cause_words(cause: Cause) -> str:
    """Return a cause as people say it."""
    return KINDS[cause.kind].format(cause.joint)


def cause_unit_and_factor(cause: Cause, place: int = 0) -> tuple[str, float]:
    """Return the unit of a number of a cause on the wire, and what converts SI to it."""
    if cause.kind == "scale":
        return "ppm", PPM
    if cause.frame:
        return ("mm", MM) if place < 3 else ("deg", DEG)
    unit, factor = ("mm", MM) if cause.slides else ("deg", DEG)
    if cause.kind == "sag":
        return (f"{unit}/N" if cause.slides else f"{unit}/(N m)"), factor
    return unit, factor


def cause_document(one: Judged) -> dict[str, Any]:
    """Return a cause as the contract has it."""
    names = FRAME if one.cause.frame else ("value",)
    numbers = []
    told = zip(names, one.change, one.u95, one.summed, QUANTILE * one.summed_sigma, strict=True)
    for place, (name, change, half, summed, half_summed) in enumerate(told):
        unit, factor = cause_unit_and_factor(one.cause, place)
        u95, summed_u95 = (float(value * factor) if np.isfinite(value) else None for value in (half, half_summed))
        number = {"name": name, "unit": unit, "change": float(change * factor), "u95": u95}
        numbers.append({**number, "summed": float(summed * factor), "summed_u95": summed_u95})
    return {
        "name": one.cause.name,
        "kind": one.cause.kind,
        "joint": one.cause.joint,
        "words": cause_words(one.cause),
        "numbers": numbers,
        "gain": one.gain,
        "bic": one.bic,
        "refuted": one.refuted,
    }


def smallest_documents(found: Check) -> list[dict[str, Any]]:
    """Return the smallest changes that the rows show, in the order of the causes."""
    causes = {one.cause.name: one.cause for one in found.judged}
    out = []
    for name, value in found.smallest.items():
        unit, factor = cause_unit_and_factor(causes[name])
        out.append({"name": name, "words": cause_words(causes[name]), "value": float(value * factor), "unit": unit})
    return out


def sentence(found: Check, agreed_at: datetime | None = None) -> str:
    """Return the verdict in one sentence, and others on its conditions and on what could not be seen."""
    return _verdict(found, agreed_at) + condition_words(found) + _limitation_words(found)


def condition_words(found: Check) -> str:
    """Say what the verdict takes for granted of temperature and set-up, and how the rows scatter; empty of nothing."""
    within, setup = found.conditions.within_k, found.conditions.setup
    taken = [f"the arm was within {within:g} K of its temperature at the fit"] if within > 0.0 else []
    taken += [f"the set-up repeats to {to_mm(setup):.2g} mm"] if setup > 0.0 else []
    said = f" This holds if {' and '.join(taken)}." if taken else ""
    if found.scatter < SCATTER:
        return said
    return f"{said} The rows scatter {found.scatter:.2g} times as much as the version's, which counts as their noise."


def _limitation_words(found: Check) -> str:
    """What a check did not see because frames were fitted first, or nobody measured a place; empty of any other."""
    unseen = ", ".join(cause_words(one) for one in found.unseen)
    if found.joint_log:
        return f" A joint log alone does not show: {unseen}."
    if not found.new_setup:
        return ""
    frames = " and ".join(found.new_setup)
    alike = f" ({unseen})" if unseen else ""
    return f" This is with {frames} set up anew: what looks like that is not seen{alike}."


def _verdict(found: Check, agreed_at: datetime | None) -> str:
    unit = "mm by views" if found.by_views else "mm"
    apart = f"measured and predicted are {to_mm(found.misfit):.3g} {unit} apart (rms)."
    if found.verdict == "ok":
        return f"ok: {found.poses} poses agree with the version; {apart}"
    after = "" if agreed_at is None else f" since {agreed_at:%Y-%m-%d}"
    chance = f" Chance of a false alarm: {chance_words(found.p_value)}. {apart.capitalize()}"
    if found.verdict == "moved":
        return f"moved: {by_how_much(found.causes[0])}{after}.{chance}"
    if not found.causes:
        return f"cannot tell: it has moved{after}, and no single cause explains the rows.{chance}"
    return f"cannot tell: {joined_by_or([by_how_much(one) for one in found.causes])}{after}.{chance}"


def chance_words(p_value: float, digits: int = 1) -> str:
    """Return a chance in a few digits, where anybody tells them apart."""
    return f"{p_value:.{digits}g}" if p_value >= LEAST_CHANCE else "less than one in a million"


def rezero_sentence(found: Rezeroed, start: str, rows: int, campaign: str) -> str:
    """Return what was changed in a version, by how many rows of which campaign."""
    changes = " and ".join(by_how_much(one) for one in found.changed_causes)
    setup = f" with {' and '.join(found.before.new_setup)} set up anew" if found.before.new_setup else ""
    return (
        f"Version {start} re-zeroed{setup}: {changes}; everything else is as it was identified. The {rows} rows of "
        f"{campaign} were used for that, so errors on them flatter: rows measured from now on say how good it is."
    )


def by_how_much(one: Judged) -> str:
    """Return a cause with its change: `zero of joint 3 by 0.21 deg (0.19 to 0.23)`; of a frame its shift and its rotation."""
    words = cause_words(one.cause)
    if not one.cause.frame:
        unit, factor = cause_unit_and_factor(one.cause)
        value, u95 = float(one.change[0] * factor), float(one.u95[0] * factor)
        return f"{words} by {value:.3g} {unit} ({value - u95:.3g} to {value + u95:.3g})"
    seen = np.isfinite(one.sigma)
    parts = []
    shift, rotation = one.size_u95
    for places, u95, factor, unit in ((slice(0, 3), shift, MM, "mm"), (slice(3, 6), rotation, DEG, "deg")):
        if seen[places].any():
            size = float(np.linalg.norm(one.change[places][seen[places]]))
            low, high = max(0.0, size - u95) * factor, (size + u95) * factor
            parts.append(f"{size * factor:.3g} {unit} ({low:.3g} to {high:.3g})")
    return f"{words} by {' and '.join(parts)}" if parts else words


def joined_by_or(words: Sequence[str]) -> str:
    """Return alternatives: `a`, `a or b`, `a, b or c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def remedy(found: Check, names: Sequence[str] = ()) -> str | None:
    """Return what to do about a verdict, or what would settle it; ``names`` are the parameters of the version."""
    said = _remedy(found, names)
    warm = found.verdict == "cannot_tell" and found.conditions.within_k > 0.0  # a single cause is none of warmth
    return STATE_WARMTH + said if warm and said else said


def _remedy(found: Check, names: Sequence[str]) -> str | None:
    if found.verdict == "ok":
        return None
    if found.verdict == "moved":
        return _repair(found.causes[0].cause, names)
    if not found.causes:
        return SEARCH
    kinds = {one.cause.kind: one.cause for one in found.causes}
    zeros = [one.cause.joint for one in found.causes if one.cause.kind == "zero"]
    if "base" in kinds and zeros:
        return MASTERING.format(joint=zeros[0], place="the bolts of the base", thing="the base")
    if "tool" in kinds and zeros:
        return MASTERING.format(joint=zeros[0], place="the bolts of the tool", thing="the flange")
    return MORE_POSES


def _repair(cause: Cause, names: Sequence[str]) -> str:
    if cause.kind == "scale":
        return INSTRUMENT
    if cause.kind == "sag":
        return LOADED + MOVED if f"compliance_{cause.joint}" in names else NO_NUMBER
    return ANEW.get(cause.kind, "") + MOVED


def faint_sentence(one: Faint) -> str:
    """Return what poses do not show of a zero, why, and what would."""
    words, (unit, factor) = cause_words(one.cause), cause_unit_and_factor(one.cause)
    if one.seen is None:
        off = "" if one.lever is None else f" The measured point is {to_mm(one.lever):.2g} mm off that axis."
        return f"The {words} is not seen at all, whatever the poses.{off}"
    step = (SLIDE if one.cause.slides else ZERO) * factor
    begins = (
        f"A step of {step:.2g} {unit} of the {words} does not alarm in 95 % of the checks: that begins at "
        f"{one.seen * factor:.2g} {unit}."
    )
    if one.lever is None or one.needed is None:
        return f"{begins} About {one.poses} such poses would show it."
    return (
        f"{begins} The measured point is at most {to_mm(one.lever):.3g} mm off that axis; {to_mm(one.needed):.3g} mm would "
        f"show it, or about {one.poses} such poses."
    )


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
