"""Wanted joints in, offsets out: the kernels of the core, the version that is in use, and the guard behind them.

It knows nothing of models. Whatever a corrector answers, no offset leaves here beyond its largest value, or further from
the one before than a cycle allows.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from kilter_client.bridges.versions import Kind
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


class Guard:
    """The offset of each joint, rad.

    Args:
        joints: how many there are.
        largest_rad: of any offset.
        rate_rad_s: how fast an offset changes at most.
        ramp_s: over which offsets come in from zero, and go out.
        cycle_s: of the controller. An offset changes by no more than that allows with each answer, however long the pause
            before it was: most controllers carry it out within one cycle.

    """

    def __init__(self, joints: int, largest_rad: float, rate_rad_s: float, ramp_s: float, cycle_s: float) -> None:
        self._largest, self._most, self._part = largest_rad, rate_rad_s * cycle_s, cycle_s / max(ramp_s, cycle_s)
        self.share = 0.0  # of the offset wanted: 0 out, 1 in
        self.offset = self._wanted = (0.0,) * joints
        self._low = self._high = self.offset  # between which the offsets are that the controller carries out

    def restart(self) -> None:
        """Begin at zero: the controller's own offsets are zero."""
        self.offset = self._wanted = self._low = self._high = (0.0,) * len(self.offset)
        self.share = 0.0

    @property
    def out(self) -> bool:
        """Whether nothing is offset."""
        return self.share == 0.0 and not any(self.offset)

    def follow(self, wanted: Sequence[float] | None, cycles: int = 1, taken: bool = True) -> tuple[float, ...]:
        """Return the next offset on the way to ``wanted``; None: the last one is to go out.

        It may change as much as ``cycles`` allow: more than one only for who takes what was lost up over several cycles.
        Where the last offset was not surely ``taken``, it is as near to those before, one of which may be in force.
        """
        if taken:
            self._low = self._high = self.offset
        if wanted is not None and all(map(math.isfinite, wanted)):
            self._wanted = tuple(wanted)
            self.share = min(1.0, self.share + cycles * self._part)
        else:
            self.share = max(0.0, self.share - cycles * self._part)
        smooth = self.share * self.share * (3.0 - 2.0 * self.share)
        # One scale for all joints. Near a stretched elbow large offsets of two joints make up for each other: one that
        # went ahead of the other would take the tool further off than no correction does.
        scale = smooth * _fitting(self._largest, self._wanted)
        steps = [scale * one - now for one, now in zip(self._wanted, self.offset, strict=True)]
        most = cycles * self._most
        rooms = [
            most - (now - low if step > 0.0 else high - now)
            for now, low, high, step in zip(self.offset, self._low, self._high, steps, strict=True)
        ]
        part = min((max(0.0, room) / abs(step) for room, step in zip(rooms, steps, strict=True) if step), default=1.0)
        self.offset = tuple(
            min(max(now + min(1.0, part) * step, -self._largest), self._largest)  # which rounding may pass
            for now, step in zip(self.offset, steps, strict=True)
        )
        self._low = tuple(map(min, self._low, self.offset))
        self._high = tuple(map(max, self._high, self.offset))
        return self.offset


def _fitting(bound: float, numbers: Sequence[float]) -> float:
    """The share, 1 at most, of these numbers at which none is beyond the bound."""
    largest = max(map(abs, numbers))
    return 1.0 if largest <= bound else bound / largest
