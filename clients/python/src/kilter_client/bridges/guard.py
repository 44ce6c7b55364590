"""What stands between a corrected setpoint and the arm: offsets of bounded size and rate, ramped in and out.

It knows nothing of models. Whatever a corrector answers, no offset leaves here beyond its largest value, or further from
the one before than a cycle allows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence


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
