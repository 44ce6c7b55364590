"""KUKA RobotSensorInterface: XML over UDP. The controller asks every cycle; the answer has its IPOC and the offsets AK, deg."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum

from kilter_client.bridges.loop import Request, radians

PORT = 59152
AXES = 6
# Whoever sends the message chooses its bytes: no search may go on beyond the element in which it began.
_IPOC = re.compile(rb"<IPOC>\s{0,9}+(\d{1,18}+)\s{0,9}+</IPOC>")
_DELAY = re.compile(rb"<Delay\s([^<>]{1,99}+)>")
_MISSED = re.compile(rb"\bD=[\"'](\d{1,9})[\"']")
_AXIS = re.compile(rb"\bA([1-6])=[\"']([^\"'<>]{1,32})[\"']")


class From(StrEnum):
    """Which joints of the message are the wanted ones."""

    SETPOINT = "ASPos"
    ACTUAL = "AIPos"


class RsiWire:
    """Messages for an arm of ``signs`` (n,): +1 where an axis has the direction of the robot's joint, -1 where the opposite.

    ``source`` ``ASPos`` takes the setpoints of the interpolator. ``AIPos`` takes the actual joints less the offsets that
    were answered before: for controllers that send nothing else.
    """

    def __init__(self, signs: Sequence[float], source: From = From.SETPOINT, cycle_ms: float = 4.0) -> None:
        self._signs, self._source, self._cycle_ms = tuple(signs), source, cycle_ms
        self._element = re.compile(rb"<" + source.value.encode() + rb"\s([^<>]{1,400}+)>")
        self._answered = (0.0,) * len(self._signs)
        self.counts: Counter[str] = Counter()

    def read(self, data: bytes) -> Request | None:
        """Return a request; None where the message is not whole, or without an IPOC, which an answer must have."""
        whole, ipoc = data.strip(b" \t\r\n\0"), _IPOC.search(data)
        if ipoc is None or not (whole.startswith(b"<Rob") and whole.endswith(b"</Rob>")):
            return None
        delay = _DELAY.search(data)
        missed = None if delay is None else _MISSED.search(delay[1])
        return Request(int(ipoc[1]), self._joints(data), None if missed is None else int(missed[1]))

    def _joints(self, data: bytes) -> tuple[float, ...] | None:
        found = self._element.search(data)
        if found is None:
            return None
        axes = {int(axis): text for axis, text in _AXIS.findall(found[1])}
        try:
            degrees = [float(axes[k]) for k in range(1, len(self._signs) + 1)]
        except (KeyError, ValueError):
            return None
        q = radians(degrees, self._signs)
        if self._source is From.ACTUAL:
            q = tuple(a - b for a, b in zip(q, self._answered, strict=True))
        return q

    def cycles(self, stamps: int) -> int | None:
        """Return the cycles between IPOCs so far apart, which count milliseconds; None where they count something else."""
        cycles, rest = divmod(stamps, self._cycle_ms)
        return round(cycles) if cycles >= 1.0 and rest == 0.0 else None

    def wanted_joints(self, request: Request, cycles: int, fresh: bool) -> Sequence[float] | None:
        """Return the joints of the message: the controller has its own plan."""
        return request.joints

    def answer(self, request: Request, offset: Sequence[float]) -> bytes:
        """Return the answer: AK in deg, of axes beyond the robot's joints zero."""
        self._answered = tuple(offset)
        degrees = [math.degrees(sign * one) for sign, one in zip(self._signs, offset, strict=True)]
        degrees += [0.0] * (AXES - len(degrees))
        axes = " ".join(f'A{k}="{value:.6f}"' for k, value in enumerate(degrees, 1))
        return f'<Sen Type="Kilter"><AK {axes}/><IPOC>{request.stamp}</IPOC></Sen>'.encode()
