"""A reference controller: moves an arm between two postures at 1 kHz through the corrector.

    python examples/python/controller.py my-arm --from 0 0 0 0 0 0 --to 20 -10 30 0 0 0 --seconds 5

Angles in degrees. It shows what a controller decides: it follows corrected setpoints, rides through a few held ones, and
slows down to a stop on its path while the corrector is away, going on when it is back. ``Arm.move`` is where the drives of
a real arm are told.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence

from kilter_client.stream import Setpoint, Statistics, StreamError, corrected

RATE_HZ = 1000.0
STOP_S = 0.3  # from full speed to rest


class Arm:
    """Simulates the drives: keeps the last command and the largest step between two."""

    def __init__(self) -> None:
        self.q: tuple[float, ...] = ()
        self.commands = 0
        self.largest_step_rad = 0.0

    def move(self, q: Sequence[float]) -> None:
        """Command joints, rad."""
        if self.q:
            self.largest_step_rad = max(self.largest_step_rad, *(abs(a - b) for a, b in zip(q, self.q, strict=True)))
        self.q = tuple(q)
        self.commands += 1


class Motion:
    """Setpoints on a smooth path; ``speed`` between 0 and 1 slows the motion along it."""

    def __init__(self, start: Sequence[float], end: Sequence[float], seconds: float) -> None:
        self._start, self._end, self._seconds = start, end, seconds
        self._cycles_left = 50 * round(seconds * RATE_HZ)  # a corrector that stays away ends the motion some day
        self.speed = 1.0
        self.stopping = False

    def __iter__(self) -> Iterator[list[float]]:
        t = 0.0
        while t < self._seconds and self._cycles_left:
            self._cycles_left -= 1
            change = 1.0 / (STOP_S * RATE_HZ)
            self.speed = max(0.0, self.speed - change) if self.stopping else min(1.0, self.speed + change)
            t += self.speed / RATE_HZ
            s = min(t / self._seconds, 1.0)
            share = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)  # at rest at both ends, without jerk there
            yield [a + share * (b - a) for a, b in zip(self._start, self._end, strict=True)]

    def heed(self, setpoint: Setpoint) -> None:
        """Slow down while corrections are missing."""
        self.stopping = setpoint.source == "bypass"


def run(robot: str, motion: Motion, arm: Arm) -> Statistics:
    """Move the arm along the motion; returns what happened to the setpoints."""
    statistics = Statistics()
    # The arm rests at the first setpoint, but uncorrected: the correction ramps in over the first second.
    for q in corrected(motion, robot, period_s=1.0 / RATE_HZ, hold_cycles=10, statistics=statistics):
        motion.heed(q)
        arm.move(q)
    return statistics


def main() -> None:
    """Run one motion and print its statistics."""
    parser = argparse.ArgumentParser(description="Move an arm between two postures through the corrector.")
    parser.add_argument("robot")
    parser.add_argument("--from", dest="start", type=float, nargs="+", required=True, metavar="DEG")
    parser.add_argument("--to", dest="end", type=float, nargs="+", required=True, metavar="DEG")
    parser.add_argument("--seconds", type=float, default=5.0)
    given = parser.parse_args()
    start, end = ([math.radians(x) for x in values] for values in (given.start, given.end))
    arm = Arm()
    try:
        statistics = run(given.robot, Motion(start, end, given.seconds), arm)
    except StreamError as error:
        parser.exit(1, f"{error}\n")
    said = {"commands": arm.commands, "largest_step_deg": round(math.degrees(arm.largest_step_rad), 5)}
    print(json.dumps({**said, **statistics.document()}))


if __name__ == "__main__":
    main()
