"""What `franka-sim` 1.1.7 does with joint positions: what it extrapolates, what it takes back, and how it judges commands.

Written after its source, in plain numpy and with a clock of its own. A cycle whose command does not come is extrapolated at
constant acceleration, as the robot's documents say. A command that comes after its cycle is dropped by the robot; the
simulator goes back to where it was before it extrapolated, takes the command, and differences the next one over all
cycles since: its speed is then the mean of them, and one that is extrapolated meanwhile goes on from the late one by a
single cycle.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
CYCLE_S = 0.001
NONE: Mapping[int, float] = MappingProxyType({})
MOST_RAD_S2, MOST_RAD_S3 = 10.0, 5000.0  # of an FR3


class History(NamedTuple):
    """Position, speed and acceleration that a command is judged by, and the cycle they are of."""

    q: Floats
    speed: Floats
    curve: Floats
    cycle: int


class State(NamedTuple):
    """What a program reads of the robot."""

    q_d: Floats
    dq_d: Floats
    ddq_d: Floats
    control_command_success_rate: float = 1.0


class Judge:
    """The robot. ``drops`` what is late, as the real one does, or takes it, as the simulator.

    ``held_s`` is how long whoever waits for a state is held up before it has it, by the number of the state; ``stands_s`` how
    long it stands still itself before a cycle, as a simulator does on a busy machine.
    """

    def __init__(
        self, at: tuple[float, ...], drops: bool = False,
        held_s: Mapping[int, float] = NONE, stands_s: Mapping[int, float] = NONE,
    ) -> None:  # fmt: skip
        zero = np.zeros(len(at))
        self._held_s, self._states = held_s, 0
        self._stands_s, self._stood_s = dict(stands_s), 0.0
        self.now_s, self.cycle, self._drops = 0.0, 0, drops
        self._history = History(np.array(at), zero, zero, 0)
        self._before_gap: History | None = None
        self._answered = self._armed = False
        self._read = -1
        self._state = self._seen()
        self.told = [self._history.q]  # where it wanted the arm in each cycle
        self.curves, self.jerks = [0.0], [0.0]  # the largest of each command that it judged
        self.missed = self.most_missed = 0  # cycles in a row without a command in time: at 20 the robot stops

    def readOnce(self) -> tuple[State, Any]:
        """Return the newest state, or the next one if that was read, and the time since the last that was."""
        self._publish(max(self._read + 1, self._due()))
        self.now_s = max(self.now_s, self.cycle * CYCLE_S + self._stood_s)
        passed, self._read = self.cycle - self._read, self.cycle
        self._states += 1
        self.now_s += self._held_s.get(self._states, 0.0)
        return self._state, Passed(passed * CYCLE_S)

    def writeOnce(self, command: Any) -> None:
        """Take the answer to the state that was read last."""
        self._publish(self._due())
        self._armed = True
        late = self._read < self.cycle
        if late and (self._drops or self._before_gap is None or self._read <= self._before_gap.cycle):
            return
        if late:
            assert self._before_gap is not None
            self._history = self._before_gap
        else:
            self._answered = True
        q, cycles = np.array(command.q), max(1, self._read - self._history.cycle)
        step_s = cycles * CYCLE_S
        speed = (q - self._history.q) / step_s
        curve = (speed - self._history.speed) / step_s
        self.curves.append(float(np.abs(curve).max()))
        self.jerks.append(float(np.abs(curve - self._history.curve).max() / step_s))
        self._history = History(q, speed, curve, self._read)
        self._before_gap = self._history if late else None

    def _due(self) -> int:
        return int((self.now_s - self._stood_s) / CYCLE_S + 1e-9)

    def _publish(self, until: int) -> None:
        while self.cycle < until:
            if self._armed and not self._answered:
                self._before_gap = self._before_gap or self._history
                q, speed, curve, cycle = self._history
                speed = speed + CYCLE_S * curve
                self._history = History(q + CYCLE_S * speed, speed, curve, cycle + 1)
                self.missed += 1
                self.most_missed = max(self.most_missed, self.missed)
            else:
                self.missed = 0
            self.told.append(self._history.q)
            self._answered = False
            self.cycle += 1
            self._stood_s += self._stands_s.pop(self.cycle, 0.0)
            self._state = self._seen()

    def _seen(self) -> State:
        """The state that goes out: its messages have floats of 32 bit."""
        q, speed, curve = (value.astype(np.float32).astype(float) for value in self._history[:3])
        return State(q, speed, curve)


class Passed(NamedTuple):
    """A duration of libfranka."""

    seconds: float

    def to_sec(self) -> float:
        """Seconds."""
        return self.seconds
