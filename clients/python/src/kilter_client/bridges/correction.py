"""Wanted joints in, offsets out: the kernels of the core, the version that is in use, and the guard behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from kilter_client.bridges.guard import Guard
from kilter_client.bridges.news import Kind
from kilter_core.correct import JOINT_LIMIT, NOT_FINITE, OK, RATE_LIMIT, TOO_LARGE, Stored, Track, from_bytes, warm_up
from kilter_core.errors import OptionError

REFUSED = {
    NOT_FINITE: "NOT_FINITE",
    JOINT_LIMIT: "JOINT_LIMIT",
    TOO_LARGE: "CORRECTION_TOO_LARGE",
    RATE_LIMIT: "RATE_LIMIT",
}
ROBOT_BYTES = 48  # of a robot's name in a program


class Correction:
    """The offsets of one arm. ``off`` says why there are none; empty while it corrects.

    ``makes_up``: whoever sends the offsets takes up what changed in lost cycles smoothly, so that the time lost counts.
    """

    def __init__(self, stored: Stored, robot: str, guard: Guard, cycle_s: float, makes_up: bool = False) -> None:
        self._robot, self._guard, self._cycle_s, self._makes_up = robot, guard, cycle_s, makes_up
        self._stored = stored
        self._track = Track(stored.program, settled=True)
        self._since_s = 0.0  # since the last setpoint that was answered
        self.off = self._foreign(stored)
        self.server = ""
        self.refused: Counter[str] = Counter()
        self.last = "OK"
        self._largest_rad = 0.0
        warm_up()

    @property
    def joints(self) -> int:
        """Number of joints that are offset."""
        return len(self._guard.offset)

    @property
    def out(self) -> bool:
        """Whether nothing is offset."""
        return self._guard.out

    @property
    def offset(self) -> tuple[float, ...]:
        """The last offsets, rad."""
        return self._guard.offset

    def reset_to_zero(self) -> None:
        """Begin at zero: a controller that starts has no offsets yet."""
        self._guard.restart()
        self._track.restart(settled=True)
        self._since_s = 0.0

    def hear(self, kind: Kind, text: bytes) -> None:
        """Take over what the companion says."""
        if kind is Kind.PROGRAM:
            self._change(text)
        elif kind is Kind.OFF:
            self.off = text.decode()
        elif kind is Kind.SERVER:
            self.server = text.decode()

    def _change(self, content: bytes) -> None:
        try:
            stored = from_bytes(content)
        except OptionError as error:
            self.off = f"the active version's program cannot be used: {error}"
            return
        foreign = self._foreign(stored)
        if not foreign and self.off:
            self._track.restart(settled=True)  # the guard ramps it in
        if not foreign and self._track.program.n_joints != self.joints:  # it began with that of another arm
            self._track, self._stored = Track(stored.program, settled=True), stored
        elif not foreign and (stored.number, stored.robot) != (self._stored.number, self._stored.robot):
            self._track.change(stored.program)
            self._stored = stored
        self.off = foreign

    def _foreign(self, stored: Stored) -> str:
        named = self._robot.encode()[:ROBOT_BYTES].decode(errors="ignore")
        if stored.robot != named:
            return f"version {stored.version_id} is of robot {stored.robot}, not of {self._robot}"
        if stored.program.n_joints != self.joints:
            return f"version {stored.version_id} is for {stored.program.n_joints} joints, not {self.joints}"
        return ""

    def step(self, q: Sequence[float] | None, cycles: int = 1, taken: bool = True) -> tuple[float, ...]:
        """Return the offsets (n,) rad for wanted joints (n,) rad, ``cycles`` after the last ones; None: they are not known.

        ``taken``: the controller surely carries the last offsets out.
        """
        offset = self._compute_offset(q, cycles, taken)
        self._largest_rad = max(self._largest_rad, max(map(abs, offset)))
        return offset

    def _compute_offset(self, q: Sequence[float] | None, cycles: int, taken: bool) -> tuple[float, ...]:
        self._since_s += cycles * self._cycle_s
        passed = cycles if self._makes_up else 1
        if self.off:
            return self._guard.follow(None, passed, taken)
        if q is None:
            self._note("BAD_FRAME")
            return self._guard.follow(None, passed, taken)
        status = self._track.step(np.array(q, dtype=np.float64), 1, self._since_s)
        if status != OK:
            self._note(REFUSED.get(status, str(status)))
            if status == RATE_LIMIT:  # its past is the reason: begin anew, at the guard's pace
                self._track.restart(settled=True)
            return self._guard.follow(None, passed, taken)
        self._since_s, self.last = 0.0, "OK"
        return self._guard.follow(
            [new - old for new, old in zip(self._track.out.tolist(), q, strict=True)], passed, taken
        )

    def _note(self, status: str) -> None:
        self.last = status
        self.refused[status] += 1

    def document(self) -> dict[str, Any]:
        """What is to be said of it, JSON-able."""
        share = self._guard.share
        going = "off" if self.off else "holding back" if self.last != "OK" else "correcting"
        there = share == 1.0 if going == "correcting" else self.out  # the rate may hold offsets longer than the ramp
        state = going if there else "fading out" if going != "correcting" else "ramping in"
        return {
            "state": state,
            "why": self.off or (self.last if self.last != "OK" else ""),
            "version_id": self._stored.version_id,
            "version": f"{self._stored.number:016x}",
            "share": round(share, 4),
            "offset_rad": [round(one, 9) for one in self.offset],
            "largest_offset_rad": round(self._largest_rad, 9),
            "refused": dict(self.refused),
            "server": self.server,
        }
