"""What people may look at while a stream runs: ten small messages a second for each stream, while somebody listens.

The setpoints themselves go to their controller only. A second subscriber to them would cost the stream a message for every
setpoint; these messages are made by the housekeeping from what the answers left in memory, and cost a setpoint nothing.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Mapping, Set
from typing import Any

import numpy as np
import zenoh

from kilter_service.stream.corrector import endpoints
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.fast_path import Answered
from kilter_service.stream.corrector.session import StreamSpec
from kilter_service.stream.corrector.slots import Gate, Served, Slots

PERIOD_S = 0.1
MINUTE, SECOND_NS = 60, 1_000_000_000
ALL_S = 1.0  # so often even what stands still is told, to whoever came later


class TurnedAway:
    """Setpoints that were refused without a slot, by stream and status: a robot without a version has no other trace."""

    MOST = 64

    def __init__(self) -> None:
        self.counts: dict[tuple[str, str], dict[str, int]] = {}
        self.seen_ns: dict[tuple[str, str], int] = {}

    def count(self, out: str, status: str) -> None:
        """Count a refusal; ``out`` is the key of its answer. Whoever sends chooses the names, so there are not many."""
        place = (endpoints.robot_from_key(out), endpoints.stream_from_key(out))
        if place not in self.counts and len(self.counts) >= self.MOST:
            self.counts, self.seen_ns = {}, {}
        counted = self.counts.setdefault(place, {})
        counted[status] = counted.pop(status, 0) + 1  # the last one is the latest
        self.seen_ns[place] = time.monotonic_ns()

    def refused_count(self, place: tuple[str, str]) -> int:
        """How many were refused."""
        return sum(list(self.counts.get(place, {}).values()))

    def document(self, place: tuple[str, str]) -> dict[str, Any]:
        """What is known of a stream without a slot."""
        counts = dict(self.counts.get(place, {}))
        return {
            "version_id": None,
            "epoch": None,
            "received": sum(counts.values()),
            "counters": counts,
            "last_status": next(reversed(counts), None),
            "seen_ns": self.seen_ns.get(place, 0),
            "last": None,
        }


class Telemetry:
    """Publishes on ``stream/{stream}/live`` of each stream, while somebody subscribes to it."""

    def __init__(
        self,
        session: zenoh.Session,
        spec: StreamSpec,
        gate: Gate,
        slots: Slots,
        active: Mapping[str, Active],
        turned_away: TurnedAway,
    ) -> None:
        self._session, self._spec, self._gate = session, spec, gate
        self._slots, self._active, self._turned_away = slots, active, turned_away
        self._ways: dict[tuple[str, str], zenoh.Publisher] = {}
        self._told: dict[tuple[str, str], int] = {}  # the last setpoint of each that somebody was told
        self._minutes: dict[tuple[str, str], deque[tuple[int, list[float], float]]] = {}
        self._all_s = 0.0
        self.watched = False

    def latest(self, served: Served) -> dict[str, Any]:
        """What a report has beside the counters: the latest answer, and one a second of the last minute, the oldest first.

        An entry is the time of day in ns, the correction of each joint (rad or m), and how far the tool moves (m).
        """
        last, now = served.stream.last_answer, time.time_ns()
        place = (served.robot, endpoints.stream_from_key(served.status_key))
        minute = self._minutes.setdefault(place, deque(maxlen=MINUTE))
        if last is None:
            return {}
        told = answer_document(last)
        if not minute or now - minute[-1][0] >= SECOND_NS:
            joints = [float(f"{value:.5g}") for value in told["correction"]]
            minute.append((now, joints, float(f"{math.hypot(*told['tool']):.5g}")))
        active = self._active.get(served.robot)
        names = {"joints": list(active.joint_names), "joint_kinds": list(active.joint_kinds)} if active else {}
        return {"last": told, "minute": [one for one in minute if now - one[0] <= MINUTE * SECOND_NS], **names}

    def publish_changes(self) -> None:
        """Publish what moved since the last time, and everything once a second, as far as somebody listens."""
        away, served = self._turned_away, self._slots.served.values()
        streams = {(one.robot, endpoints.stream_from_key(one.status_key)): one for one in list(served)}
        self._follow(away.counts.keys() | streams.keys())
        now = time.monotonic()
        everything = now - self._all_s >= ALL_S
        self._all_s = now if everything else self._all_s
        # zenoh's own types say bool here
        listened = [place for place, way in self._ways.items() if way.matching_status.matching]  # type: ignore[attr-defined]
        self.watched = bool(listened)
        self._told = {place: self._told.get(place, -1) for place in listened}
        for place in listened:
            served_there = streams.get(place)
            received = (
                away.refused_count(place) if served_there is None else sum(served_there.stream.counters.by_status)
            )
            if everything or self._told[place] != received:
                self._told[place] = received
                document = away.document(place) if served_there is None else self._document(served_there)
                self._ways[place].put(self._sign_document(place, document), encoding=zenoh.Encoding.APPLICATION_JSON)

    def _follow(self, places: Set[tuple[str, str]]) -> None:
        """Have a way out for each of these streams, and for no other."""
        for gone in self._ways.keys() - places:
            self._minutes.pop(gone, None)
            self._ways.pop(gone).undeclare()  # type: ignore[no-untyped-call]
        for robot, stream in places - self._ways.keys():
            self._ways[robot, stream] = self._session.declare_publisher(
                endpoints.RobotKeys(self._spec.site, robot).stream(stream, "live"),
                priority=zenoh.Priority.BACKGROUND,
                congestion_control=zenoh.CongestionControl.DROP,
            )

    def _sign_document(self, place: tuple[str, str], document: dict[str, Any]) -> bytes:
        """Sign a document as the corrector signs whatever it announces."""
        told = {"instance": self._spec.instance, "at_ns": time.time_ns(), "moment_ns": time.monotonic_ns()}
        body = json.dumps(told | document).encode()
        site, masters = self._spec.site, self._gate.masters
        return masters.sign_announcement(
            endpoints.RobotKeys(site, place[0]).stream(place[1], "live"), site, place[0], body
        )

    def _document(self, served: Served) -> dict[str, Any]:
        active = self._active.get(served.robot)
        last, counters = served.stream.last_answer, served.stream.counters
        return {
            "version_id": active.version_id if active else None,
            "epoch": active.epoch if active else None,
            **counters.document(),
            "by_time": counters.by_time,
            "signed": served.guard.is_signed,
            "joints": list(active.joint_names) if active else [],
            "joint_kinds": list(active.joint_kinds) if active else [],
            "seen_ns": served.stream.seen_ns,
            "last": None if last is None else answer_document(last),
        }


def answer_document(last: Answered) -> dict[str, Any]:
    """A corrected setpoint in numbers: rad or m of each joint, m at the tool, mm of what is left there."""
    wanted, corrected, tool = (np.frombuffer(part) for part in (last.wanted, last.corrected, last.tool))
    return {
        "arrival_ns": last.arrival_ns,
        "flags": last.flags,
        "wanted": wanted.tolist(),
        "correction": (corrected - wanted).tolist(),
        "tool": tool.tolist(),
        "left_mm": last.left_nm * 1e-6,
    }
