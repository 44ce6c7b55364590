"""The streams that are served: who gets a slot, and who gives it back.

Anybody who reaches the corrector can make up names. So a robot without a version has no slots, a stream in good use keeps
its own whatever else comes in; of all others, the one whose last good setpoint is the oldest loses its slot. A stream that
loses its slot loses its sequence, so the nonces given until then lose their use.
"""

from __future__ import annotations

from dataclasses import dataclass

import zenoh

from kilter_service.stream.corrector import keys
from kilter_service.stream.corrector.gate import Address, Gate
from kilter_service.stream.corrector.guard import Guard
from kilter_service.stream.corrector.session import ENCODING
from kilter_service.stream.corrector.specs import Rules
from kilter_service.stream.corrector.stream import Stream


@dataclass
class Served:
    """A stream with its way out."""

    robot: str
    stream: Stream
    guard: Guard
    publisher: zenoh.Publisher
    status_key: str
    key: zenoh.KeyExpr
    verdict: int = -1  # on the last setpoint
    reported: tuple[int, int] = (-1, -1)
    follower: Served | None = None  # whose setpoint came after the last one of this stream

    def in_use(self, arrival_ns: int, rules: Rules) -> bool:
        """Whether a controller depends on it: more than one good setpoint, and not long ago."""
        return self.stream.good > 1 and arrival_ns - self.stream.seen_ns < rules.idle_ns


class Slots:
    """Streams by the key of their setpoints; a new dictionary with every change, because the housekeeping reads it too."""

    def __init__(self, session: zenoh.Session, rules: Rules, gate: Gate) -> None:
        self.served: dict[str, Served] = {}
        self._session = session
        self._rules = rules
        self._gate = gate

    def allocate_slot(self, key: str, names: tuple[str, str, str], arrival_ns: int) -> Served | None:
        """A slot for a stream (``names`` of its robot, answers and status), or None when all are in use."""
        robot, out, status = names
        if len(self.served) >= self._rules.slots and not self._free_slots(arrival_ns):
            return None
        publisher = self._session.declare_publisher(
            out,
            encoding=zenoh.Encoding(ENCODING),
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.DROP,
            express=False,  # express with DROP loses samples in bursts and is no faster
        )
        # Once declared to the peers, the key travels as a number. Otherwise every setpoint carries its text, and a
        # subscription with wildcards is looked up again: 10 to 25 µs a round trip.
        declared = self._session.declare_keyexpr(key)
        stream = Stream(self._rules)
        guard = Guard(self._gate, address_from_key(key), stream)
        served = Served(robot, stream, guard, publisher, status, declared)
        self.served = {**self.served, key: served}
        return served

    def _free_slots(self, arrival_ns: int) -> bool:
        """Take back the slots of the idle ones, and of the rest that are not in use those good the longest time ago."""
        free = [(s.stream.seen_ns, key) for key, s in self.served.items() if not s.in_use(arrival_ns, self._rules)]
        free.sort()
        # Half of them at once: to look through all the slots for every new name would hold up the others.
        gone = {key: self.served[key] for _, key in free[: (len(free) + 1) // 2]}
        self.served = {key: served for key, served in self.served.items() if key not in gone}
        for served in self.served.values():
            served.follower = None  # it may be one that is gone
        if gone:
            self._gate.forget()
        for served in gone.values():
            served.follower = None
            served.publisher.undeclare()  # type: ignore[no-untyped-call]
            self._session.undeclare(served.key)
        return bool(gone)


def parse_setpoint_key(key: str) -> tuple[str, str, str] | None:
    """Robot, key of the answers and key of the status that belong to a key of setpoints; None when it is not one."""
    parts = key.split("/")
    if len(parts) != 7:
        return None
    try:
        names = keys.RobotKeys(parts[2], parts[3])
        return parts[3], names.stream(parts[5], "out"), names.stream(parts[5], "status")
    except ValueError:
        return None


def address_from_key(key: str) -> Address:
    """Site, robot and stream of a key of setpoints."""
    parts = key.split("/")
    return Address(parts[2], parts[3], parts[5])
