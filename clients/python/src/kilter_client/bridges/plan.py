"""Where the wanted joints come from where a controller has no plan of its own: from a file, or from a planner over UDP.

A bridge that answers whole joints must never answer a jump: a setpoint is followed no faster than the speed allows, and one
that is far from the last one is not followed at all.
"""

from __future__ import annotations

import csv
import math
import socket
import struct
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from kilter_client.bridges.correction import Limits
from kilter_client.errors import FileError, UsageError
from kilter_client.streaming.frames import HEADER, MAGIC, POINT

MOST_WAITING = 64
EASE_S = 0.5
FAR_S = 0.1  # of motion at the highest speed: a setpoint beyond that is not on the way of this arm


class Plan(Protocol):
    """Setpoints (n,) rad of the robot's joints."""

    counts: Counter[str]

    @property
    def is_finished(self) -> bool:
        """Whether nothing more is planned."""
        ...

    def restart_plan(self) -> None:
        """The controller has begun."""
        ...

    def next_setpoint(self, step_s: float) -> Sequence[float] | None:
        """Return the setpoint ``step_s`` after the last one; None where nothing new is planned."""
        ...


class Table:
    """The rows of a table, from the first one on when the controller begins; between rows on a straight line."""

    def __init__(self, times_s: Sequence[float], rows: Sequence[Sequence[float]]) -> None:
        self.counts: Counter[str] = Counter()
        self._times_s, self._rows = times_s, rows
        self._row, self._now_s, self._begun = 0, times_s[0], False

    @property
    def is_finished(self) -> bool:
        """Whether the last row has come."""
        return self._now_s > self._times_s[-1]

    def restart_plan(self) -> None:
        """Begin at the first row."""
        self._row, self._now_s, self._begun = 0, self._times_s[0], False

    def next_setpoint(self, step_s: float) -> Sequence[float] | None:
        """Return the setpoint after a step; the first call, and those behind the end, return the first and last row."""
        self._now_s += step_s if self._begun else 0.0
        self._begun = True
        times, row = self._times_s, self._row
        while row + 2 < len(times) and times[row + 1] <= self._now_s:
            row += 1
        self._row = row
        share = min(1.0, max(0.0, (self._now_s - times[row]) / (times[row + 1] - times[row])))
        return [a + share * (b - a) for a, b in zip(self._rows[row], self._rows[row + 1], strict=True)]


def read_table(path: Path, limits_deg: Sequence[Limits]) -> Table:
    """Read a table ``t_s,q1_deg,...`` (CSV) for joints with these limits.

    Raises:
        FileError: a column or a number is missing, the time does not grow, or a joint would leave its limits.

    """
    names = ["t_s", *(f"q{k}_deg" for k in range(1, len(limits_deg) + 1))]
    times: list[float] = []
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for line, row in enumerate(csv.DictReader(file), 2):
                numbers = [_number(row, name, f"{path}, line {line}", names, line) for name in names]
                if not all(map(math.isfinite, numbers)) or (times and numbers[0] <= times[-1]):
                    raise FileError(
                        f"{path}, line {line}: a number is not finite, or t_s does not grow: mend the row.", line=line
                    )
                _refuse_beyond(numbers[1:], limits_deg, path, line)
                times.append(numbers[0])
                rows.append([math.radians(value) for value in numbers[1:]])
    except (OSError, UnicodeError) as error:
        raise FileError(f"{path} cannot be read: {error}") from error
    except csv.Error as error:
        remedy = "write t_s and the joints with commas between them"
        raise FileError(f"{path}: is not a table of CSV ({error}): {remedy}.") from error
    if len(rows) < 2:
        raise FileError(f"{path} has fewer than two rows: give one where the path begins and one where it ends.")
    return Table(times, rows)


def _refuse_beyond(angles_deg: Sequence[float], limits_deg: Sequence[Limits], path: Path, line: int) -> None:
    k = beyond(angles_deg, limits_deg)
    if k is not None:
        low, high = limits_deg[k]
        span = f"{'open' if low is None else f'{low:g}'} to {'open' if high is None else f'{high:g}'} deg"
        raise FileError(
            f"{path}, line {line}: q{k + 1}_deg is {angles_deg[k]:g}, beyond the limits of joint {k + 1} ({span}): mend the "
            "row, or the limits of the robot.",
            line=line,
        )


def beyond(angles_deg: Iterable[float], limits_deg: Sequence[Limits]) -> int | None:
    """Return the first joint (from 0) that is beyond its limits; None where none is."""
    for k, (angle, (low, high)) in enumerate(zip(angles_deg, limits_deg, strict=False)):
        if (low is not None and angle < low) or (high is not None and angle > high):
            return k
    return None


def _number(row: Mapping[str, str | None], name: str, place: str, names: Sequence[str], line: int) -> float:
    """A cell as a number."""
    said = row.get(name)
    try:
        return float(said or "")
    except ValueError:
        what = "has no column" if name not in row else "has no number in" if not said else f"has {said!r} in"
        raise FileError(f"{place}: {what} {name}: give {', '.join(names)} in every row.", line=line) from None


class Heard:
    """Setpoints that a planner sends over UDP, as messages of the stream (kind point); the newest counts."""

    def __init__(self, port: socket.socket, joints: int, limits_deg: Sequence[Limits] = ()) -> None:
        self.counts: Counter[str] = Counter()
        self._limits_deg = limits_deg
        self._port, self._joints, self._seq = port, joints, -1
        self._layout = struct.Struct(f"<{joints}d")
        port.setblocking(False)
        self.is_finished = False

    def restart_plan(self) -> None:
        """Forget what came before the controller began."""
        self._newest()
        self._seq = -1

    def next_setpoint(self, step_s: float) -> Sequence[float] | None:
        """Return the newest setpoint that has come; None where none has."""
        return self._newest()

    def _newest(self) -> tuple[float, ...] | None:
        found = None
        for _ in range(MOST_WAITING):
            try:
                data = self._port.recv(2048)
            except (BlockingIOError, ConnectionError):
                break
            found = self._read(data) or found
        return found

    def _read(self, data: bytes) -> tuple[float, ...] | None:
        """A setpoint that is newer than the last; None for anything else, which is counted."""
        if len(data) != HEADER.size + self._layout.size:
            self.counts["plan_malformed"] += 1
            return None
        magic, kind, joints, _, seq, *_ = HEADER.unpack_from(data)
        q = self._layout.unpack_from(data, HEADER.size)
        if magic != MAGIC or kind != POINT or joints != self._joints or not all(map(math.isfinite, q)):
            self.counts["plan_malformed"] += 1
            return None
        if seq <= self._seq:
            self.counts["plan_old"] += 1
            return None
        self._seq = seq
        if beyond(map(math.degrees, q), self._limits_deg) is not None:
            self.counts["plan_beyond_limits"] += 1
            return None
        return q


class Setpoints:
    """The setpoints that are followed: those of a plan, from where the arm stands, and no faster than ``speed_rad_s``.

    What the plan's first setpoint is off from there fades out over ``EASE_S``.
    """

    def __init__(self, plan: Plan, speed_rad_s: float, cycle_s: float) -> None:
        self._plan, self._speed, self._cycle_s = plan, speed_rad_s, cycle_s
        self.at: tuple[float, ...] | None = None
        self._gap: tuple[float, ...] | None = None
        self._eased_s = 0.0

    @property
    def counts(self) -> Counter[str]:
        """What was not followed."""
        return self._plan.counts

    @property
    def is_finished(self) -> bool:
        """Whether the plan is at its end, and the arm with it."""
        return self._plan.is_finished and self._gap is not None and self._eased_s >= EASE_S

    def is_far(self, one: Sequence[float], other: Sequence[float]) -> bool:
        """Say whether joints (n,) rad are further apart than an arm moves in a tenth of a second."""
        return _farthest(one, other) > self._speed * FAR_S

    def start_from_joints(self, q: Sequence[float] | None) -> tuple[float, ...] | None:
        """Begin where the arm stands (n,) rad; None: nobody knows where that is."""
        self._plan.restart_plan()
        self.at = None if q is None else tuple(q)
        self._gap, self._eased_s = None, 0.0
        return self.at

    def step(self, cycles: int, pace: float = 1.0) -> tuple[float, ...] | None:
        """Return the setpoint (n,) rad after so many cycles; the last one where the next cannot be followed.

        ``pace`` below 1 lets the time of the plan pass more slowly.
        """
        step_s = cycles * self._cycle_s
        planned = self._plan.next_setpoint(step_s * pace)
        if planned is None or self.at is None:
            return self.at
        if self._gap is None:
            if self.is_far(planned, self.at):
                self.counts["plan_too_far"] += 1
                return self.at
            self._gap = tuple(old - new for new, old in zip(planned, self.at, strict=True))
        else:
            self._eased_s += step_s
        left = 1.0 - smooth(min(1.0, self._eased_s / EASE_S))
        self._follow([new + left * gap for new, gap in zip(planned, self._gap, strict=True)], self.at, step_s)
        return self.at

    def _follow(self, wanted: Sequence[float], at: tuple[float, ...], step_s: float) -> None:
        farthest, most = _farthest(wanted, at), self._speed * step_s
        if farthest > max(most, self._speed * FAR_S):
            self.counts["plan_too_far"] += 1
        elif farthest > most:
            self.counts["plan_slowed"] += 1
            self.at = tuple(old + (new - old) * most / farthest for new, old in zip(wanted, at, strict=True))
        else:
            self.at = tuple(wanted)


def _farthest(wanted: Sequence[float], at: Sequence[float]) -> float:
    return max(abs(new - old) for new, old in zip(wanted, at, strict=True))


def smooth(share: float) -> float:
    """From 0 to 1, with speed and acceleration zero at both ends."""
    return share**3 * (10.0 + share * (6.0 * share - 15.0))


def open_plan(path: Path | None, port: int | None, limits_deg: Sequence[Limits]) -> Plan:
    """Make the plan of a bridge: of a file, or of a UDP port of this machine; ``limits_deg`` of each joint.

    Raises:
        FileError: the file is not a path of this robot.
        UsageError: both or none is given, or the port cannot be had.

    """
    if (path is None) == (port is None):
        raise UsageError("Say where setpoints come from: --path FILE, or --setpoints-port PORT.")
    if path is not None:
        return read_table(path, limits_deg)
    assert port is not None
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        udp.bind(("127.0.0.1", port))
    except OSError as error:
        udp.close()
        remedy = "name one that no other program listens on (--setpoints-port)"
        raise UsageError(f"UDP port {port} cannot be had for setpoints: {error}: {remedy}.") from error
    return Heard(udp, len(limits_deg), limits_deg)
