"""What the corrector does for a robot, in a word and a sentence."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from kilter_service.contract.streams import Bridge
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.robots.compensation import CORRECTS, WORDS
from kilter_service.stream.bridges import service as known_bridges
from kilter_service.versions.metrics import service as observability
from kilter_service.web.health import service as health

OFF = "Not corrected"
BRIDGED = "By a bridge"
OTHER = "Other version"
TWICE = "Corrected twice"
LIVE_S = 10
UNCORRECTED = ("refusing", "holding back", "fading out", "off")  # states of a bridge whose offsets go out, or are out


@dataclass(frozen=True)
class Correcting:
    """``look`` is the badge's: good, warn, bad or faint."""

    word: str
    look: str
    sentence: str
    instead: str = ""  # the state of a robot whose active version is not what its setpoints are corrected with


@dataclass(frozen=True)
class Corrector:
    """The corrector process as the health of the server has it, and what its streams last said."""

    state: health.ProcessState
    detail: str
    streams: Sequence[Mapping[str, Any]]
    bridges: Mapping[str, Sequence[Bridge]] = field(default_factory=dict)

    def describe_correction(self, robot: str, active: str | None, compensation: str = "unknown") -> Correcting:
        """Say what it does for a robot, whose active version is given, and what its controller does by itself."""
        running = [one for one in self.bridges.get(robot, ()) if not one.gone]
        twice = next((one for one in running if one.corrected_twice), None)
        if twice is not None:  # what the controller does by itself must not hide it
            return Correcting("corrected twice", "bad", twice.sentence, TWICE)
        newest = next(iter(self.bridges.get(robot, ())), None)
        lost = newest if newest is not None and newest.gone and newest.state != "ended" else None
        if compensation in CORRECTS and lost is not None and _offset_joints(lost):  # it may go on where it runs
            return Correcting("bridge gone", "warn", lost.sentence, "Perhaps twice")
        if compensation in CORRECTS:
            said = f"The controller {WORDS[compensation]}, so its setpoints are not corrected a second time."
            return Correcting("by the controller", "faint", said, "By its controller")
        if running:  # it corrects by itself, whether or not the corrector runs
            return _of_bridge(running[0], active)
        if lost is not None and not any(one["robot"] == robot for one in self.streams):
            return Correcting("bridge gone", "bad", lost.sentence, OFF)
        if self.state == "starting":
            return Correcting("starting", "warn", f"The corrector {self.detail}: setpoints are not corrected yet.", OFF)
        if self.state == "stopped":
            return Correcting("corrector stopped", "bad", f"The corrector does not run: {self.detail}.", OFF)
        if active is None:
            return Correcting("bypassed", "warn", "The corrector passes setpoints on as they are.")
        mine = [one for one in self.streams if one["robot"] == robot]
        if not mine:
            return Correcting(
                "ready", "faint", "The corrector runs. No controller has sent it setpoints of this robot."
            )
        others = {one["version_id"] for one in mine} - {active}
        names = ", ".join(str(one["stream"]) for one in mine)
        if others:
            used = ", ".join(sorted(str(one or "no version") for one in others))
            said = f"Stream {names} last corrected with {used}, not the active one."
            # One that ended before the version was activated says nothing of the next setpoint.
            goes_on = any(one["version_id"] in others and _is_live(one) for one in mine)
            return Correcting("other version", "warn", said, OTHER if goes_on else "")
        if not any(_is_live(one) for one in mine):
            return Correcting(
                "ready", "faint", f"Stream {names} was corrected with the active version; it sends nothing now."
            )
        return Correcting("streaming", "good", f"Stream {names} is corrected with the active version.")


def corrector(database: Database, settings: Settings) -> Corrector:
    """Look at the corrector."""
    check = health.report(database, settings).checks.get("corrector")
    return Corrector(
        check.state if isinstance(check, health.ProcessCheck) else "stopped",
        "it was not looked at" if check is None else check.detail,
        observability.streams(database),
        known_bridges.of_robots(database),
    )


def _offset_joints(bridge: Bridge) -> bool:
    """Whether the joints were offset when it was last heard."""
    return bridge.state in known_bridges.OFFSETTING or bridge.offset_deg > 0.0


def _is_live(stream: Mapping[str, Any]) -> bool:
    """Whether a stream goes on: it tells each second what it does."""
    return abs(time.time_ns() - int(stream.get("at_ns") or 0)) < LIVE_S * 1_000_000_000


def _of_bridge(bridge: Bridge, active: str | None) -> Correcting:
    """What a bridge does, which runs; it may be told a version, and then corrects without an active one."""
    if bridge.state in ("correcting", "ramping in"):
        if bridge.other_version:
            return Correcting("by a bridge", "warn", bridge.sentence, OTHER if active else BRIDGED)
        return Correcting("by a bridge", "good", bridge.sentence)
    look, instead = "faint" if bridge.state == "waiting" else "warn", OFF if bridge.state in UNCORRECTED else ""
    return Correcting("bridge " + bridge.state, look, bridge.sentence, instead)
