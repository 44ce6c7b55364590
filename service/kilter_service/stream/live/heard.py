"""From what the corrector publishes to what is shown: rates, times of the last minute, and whether setpoints are corrected."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, Literal, NamedTuple

from kilter_service.ground.wire import to_deg, to_mm

SILENT_S = 1.0  # without a setpoint for so long, no controller sends
WINDOW_S = 1.0  # over which rate and condition are taken
TIMES_S = 60.0
REPORT_AGE_S = 5.0  # a report in the database is older than what the corrector told itself so short ago
RAMPING = 0x0200
MADE = {
    0x0100: "with the loads of the motion",
    RAMPING: "still being ramped in",
    0x0400: "backlash or clearance changes sides",
    0x0800: "damped near a singularity",
    0x1000: "the nearest pose that can be reached",
    0x2000: "held at its limit",
    0x4000: "held back by its rate",
    0x8000: "the version is unsure here",
}
HELD_BACK = {  # counters of the corrector, in words
    "reversing": "corrected while backlash or clearance changed sides",
    "damped": "damped near a singularity",
    "saturated": "held at the limits of the version",
    "slowed": "held back by the bound on rate and acceleration",
}
WHY = {
    "STALE": "they arrive too late",
    "SEQ_GAP": "setpoints before them are missing",
    "SEQ_BACK": "their sequence went back",
    "BAD_FRAME": "they are not valid messages",
    "NOT_FINITE": "a number is not finite",
    "JOINT_LIMIT": "a corrected joint would be outside its limits",
    "CORRECTION_TOO_LARGE": "the correction is larger than the version allows",
    "RATE_LIMIT": "they move faster than any arm can",
    "NO_VERSION": "the robot has no active version",
    "VERSION_MISMATCH": "they expect another version or another number of joints",
    "OVERLOAD": "they come faster than they can be answered",
    "NO_SESSION": "they are signed with the key of no session in use",
    "UNSIGNED": "they are not signed",
    "SESSION_EXPIRED": "the session has ended",
}


class Counted(NamedTuple):
    """Counts at a moment of the corrector's clock, s; ``held_back`` as in HELD_BACK."""

    moment_s: float
    received: int
    good: int
    held_back: tuple[int, ...]


class Heard:
    """What was heard of one stream."""

    def __init__(self) -> None:
        self._counts: deque[Counted] = deque(maxlen=32)
        self._times: deque[tuple[float, list[int]]] = deque(maxlen=int(TIMES_S) + 2)
        self._document: dict[str, Any] = {}
        self._moved_s = -math.inf  # this process's clock: when the last setpoint came
        self._told_ns = self._reported_ns = 0
        self._told_s = -math.inf

    def accept_message(self, document: dict[str, Any], now_s: float) -> bool:
        """Take a message of the corrector over; False for one that was heard before."""
        # By the corrector's monotonic clock: the time of day may be set back.
        if self._knows(document) and document["moment_ns"] <= self._told_ns:
            return False
        self._told_ns, self._told_s = document["moment_ns"], now_s
        self._take_over(document, now_s)
        return True

    def take_report(self, document: dict[str, Any], now_ns: int, now_s: float) -> None:
        """Take over what a corrector elsewhere has left in the database; ``now_ns`` is the time of day."""
        known = document["at_ns"] == self._reported_ns or now_s - self._told_s < REPORT_AGE_S
        if known and self._knows(document):
            return
        self._reported_ns = document["at_ns"]
        nothing: dict[str, Any] = {"last": None, "joints": [], "joint_kinds": []}
        timed = {"moment_ns": now_ns, "seen_ns": document["at_ns"]}
        self._take_over(nothing | document | timed, now_s)

    def _knows(self, document: dict[str, Any]) -> bool:
        return bool(document["instance"] == self._document.get("instance"))

    def _take_over(self, document: dict[str, Any], now_s: float) -> None:
        received, moment_s = int(document["received"]), document["moment_ns"] / 1e9
        before = self._document
        if before and (before["instance"] != document["instance"] or received < before["received"]):
            self._counts.clear()
            self._times.clear()
            before = {}
        if before and received > before["received"]:
            self._moved_s = now_s
        latest_ns = max(document["seen_ns"], (document["last"] or {}).get("arrival_ns", 0))
        self._moved_s = max(self._moved_s, now_s - max(0.0, moment_s - latest_ns / 1e9))
        held_back = tuple(int(document.get(name, 0)) for name in HELD_BACK)
        self._counts.append(Counted(moment_s, received, int(document["counters"].get("OK", 0)), held_back))
        by_time = document.get("by_time")
        if by_time and (not self._times or moment_s - self._times[-1][0] >= 1.0):
            self._times.append((moment_s, by_time))
        self._document = document

    def stream_view(self, name: str, now_s: float) -> StreamShown:
        """What is to be said of the stream now."""
        document, seen_s = self._document, now_s - self._moved_s
        counters = document["counters"]
        last, condition = document["last"], self._condition(seen_s)
        return StreamShown(
            name=name,
            condition=condition,
            words=_words(condition, document["last_status"], seen_s) + self._held_back_words(condition),
            rate_hz=0.0 if condition == "silent" else self._rate_hz(),
            received=int(document["received"]),
            corrected=int(counters.get("OK", 0)),
            refusals={status: count for status, count in counters.items() if count and status != "OK"},
            version_id=document["version_id"],
            seen_s=float(round(seen_s)),
            joints=[] if last is None else _joints(document, last),
            # While the correction is ramped in, the corrector knows only where that ends.
            tool_mm=None if last is None or last["flags"] & RAMPING else to_mm(math.hypot(*last["tool"])),
            left_mm=None if condition == "silent" else self._left_mm,
            most_left_mm=document.get("left_mm", {}).get("max"),
            held_back={name: int(document[name]) for name in HELD_BACK if document.get(name)},
            made=[] if last is None else [words for flag, words in MADE.items() if last["flags"] & flag],
            signed=bool(document.get("signed")),
            times=self._times_shown(),
        )

    def minute(self) -> list[Second]:
        """The last minute, as the corrector's report has it, one setpoint a second; empty where it has none."""
        scales = [to_mm if kind == "prismatic" else to_deg for kind in self._document.get("joint_kinds", [])]
        return [
            Second(at_ns / 1e9, [scale(one) for scale, one in zip(scales, joints, strict=False)], to_mm(tool))
            for at_ns, joints, tool in self._document.get("minute", [])
        ]

    @property
    def _left_mm(self) -> float | None:
        """The most that was left lately; None when the corrector does not say."""
        left_mm: float | None = self._document.get("left_mm", {}).get("lately")
        return left_mm

    def _held_back_words(self, condition: Condition) -> str:
        """What held corrections back in the last second, and what was left of the error."""
        start, end = self._recent()
        counts = zip(HELD_BACK.values(), end.held_back, start.held_back, strict=True)
        held = [
            f"{now - then} {'was' if now - then == 1 else 'were'} {words}" for words, now, then in counts if now > then
        ]
        if not held or condition == "silent":
            return ""
        left = "" if self._left_mm is None else f"; {_mm_text(self._left_mm)} of the error at the tool was left"
        return f" Of the last {end.received - start.received} setpoints {' and '.join(held)}{left}."

    def _recent(self) -> tuple[Counted, Counted]:
        end = self._counts[-1]
        return next(one for one in self._counts if end.moment_s - one.moment_s <= WINDOW_S), end

    def _rate_hz(self) -> float | None:
        start, end = self._recent()
        passed = end.moment_s - start.moment_s
        return (end.received - start.received) / passed if passed > 0.15 else None

    def _condition(self, seen_s: float) -> Condition:
        if seen_s > SILENT_S:
            return "silent"
        start, end = self._recent()
        if end.received == start.received:  # the first message of a stream that moves
            return "corrected" if self._document["last_status"] == "OK" else "bypass"
        if end.good == start.good:
            return "bypass"
        return "corrected" if end.good - start.good == end.received - start.received else "partly"

    def _times_shown(self) -> TimesShown | None:
        by_time: list[int] | None = self._document.get("by_time")
        if not by_time:
            return None
        before = next((then for at, then in self._times if self._counts[-1].moment_s - at <= TIMES_S), by_time)
        counts = [now - then for now, then in zip(by_time, before, strict=True)]
        counts = counts if any(counts) else by_time
        largest: float | None = self._document["processing_us"]["max"]
        shares = (_share_us(counts, 0.5), _share_us(counts, 0.99))
        return TimesShown(list(_edges_us(len(counts))), counts, *shares, largest)


@cache
def _edges_us(bins: int) -> tuple[float, ...]:
    """Where the bins of the corrector begin, µs: two an octave (docs/reference/stream.md)."""
    return tuple(round(2.0 ** (0.5 * k), 1) if k else 0.0 for k in range(bins))


def _mm_text(value: float) -> str:
    return f"at most {value:.3g} mm" if value >= 0.001 else "less than 0.001 mm"


def _share_us(counts: Sequence[int], share: float) -> float | None:
    """Time within which this share of the answers was made: the end of its bin."""
    total, sum_so_far = sum(counts), 0
    for k, count in enumerate(counts):
        sum_so_far += count
        if total and sum_so_far >= share * total:
            return float(round(2.0 ** (0.5 * (k + 1)), 1))
    return None


def _joints(document: Mapping[str, Any], last: Mapping[str, Any]) -> list[JointShown]:
    shown = []
    rows = zip(document["joints"], document["joint_kinds"], last["wanted"], last["correction"], strict=False)
    for name, kind, wanted, correction in rows:
        slides = kind == "prismatic"
        unit, convert = ("mm", to_mm) if slides else ("deg", to_deg)
        shown.append(JointShown(name, unit, convert(wanted), convert(correction)))
    return shown


def _words(condition: Condition, status: str | None, seen_s: float) -> str:
    why = WHY.get(status or "", "")
    match condition:
        case "corrected":
            return "Every setpoint is corrected."
        case "partly":
            return "Some setpoints are refused; the controller holds the last correction for them."
        case "bypass":
            return f"No setpoint is corrected: {why or 'the corrector refuses them'} ({status})."
    return f"No setpoint for {seen_s:.0f} s."


Condition = Literal["corrected", "partly", "bypass", "silent"]
Reach = Literal["connected", "connecting", "elsewhere", "away"]


@dataclass(frozen=True)
class JointShown:
    """A joint at the last setpoint; ``unit`` is "deg" or "mm"."""

    name: str
    unit: str
    wanted: float
    correction: float


@dataclass(frozen=True)
class Second:
    """A corrected setpoint: when, s since 1970, the correction of each joint, deg or mm, and of the tool, mm."""

    at_s: float
    joints: list[float]
    tool_mm: float


@dataclass(frozen=True)
class TimesShown:
    """Time that answers took inside the corrector, over the last minute at most.

    ``counts`` are of bins that begin at ``from_us``.
    """

    from_us: list[float]
    counts: list[int]
    p50_us: float | None
    p99_us: float | None
    largest_us: float | None  # since the stream began


@dataclass(frozen=True)
class StreamShown:
    """A stream. ``refusals``, ``received`` and ``held_back`` count since it began; ``tool_mm`` is how far the correction moves
    the tool, ``left_mm`` the most that it lately left of the error there and ``most_left_mm`` ever, None when unknown.
    """

    name: str
    condition: Condition
    words: str
    rate_hz: float | None
    received: int
    corrected: int
    refusals: dict[str, int]
    version_id: str | None
    seen_s: float
    joints: list[JointShown]
    tool_mm: float | None
    left_mm: float | None
    most_left_mm: float | None
    held_back: dict[str, int]
    made: list[str]  # how the last correction was made, in words
    signed: bool
    times: TimesShown | None


@dataclass(frozen=True)
class RobotShown:
    """All streams of a robot. ``bypass`` says why nothing, or not everything, is corrected; empty when all is well."""

    robot: str
    reach: Reach
    since: str | None  # when the corrector started
    active_version: str | None
    bypass: str
    streams: list[StreamShown] = field(default_factory=list)

    def text(self) -> str:
        """Write it as JSON."""
        return json.dumps(asdict(self))


def bypass(reach: Reach, active_version: str | None, streams: Sequence[StreamShown], twice: str = "") -> str:
    """Return why setpoints are not corrected, empty when all that come are.

    ``twice`` says that the controller corrects by itself, empty where it does not.
    """
    if reach == "away":
        return (
            "The corrector does not answer, so no setpoint is corrected. A controller that drives the arm now drives it "
            "uncorrected, or has stopped. Look at the log of `kilterd corrector`."
        )
    refused = [stream for stream in streams if stream.condition == "bypass"]
    if refused:
        said = " ".join(f"Stream {stream.name}: {stream.words}" for stream in refused)
        remedy = f" {twice}" if twice else " Activate a version." if active_version is None else ""
        return f"{said} The controller drives the arm uncorrected, or has stopped.{remedy}"
    return ""
