"""What is shown of the streams of a robot, in the units that people read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

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
