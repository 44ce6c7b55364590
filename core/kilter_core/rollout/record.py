"""What a joint was told and what it read, with the bodies it moves, on the grid on which it is simulated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kilter_core.types import Bools, Floats, Ints

BLOCK_S = 1.0  # a second is one observation
SETTLE_S = 0.3  # from the start of an episode, in which a guessed speed dies out


@dataclass(frozen=True)
class JointEpisode:
    """An episode of one joint: ``t``, ``command`` and ``reading`` (N,) in s and rad (m); along the motion that was read, the
    ``load`` of its bodies N m, its ``slope`` N m/rad and their ``inertia`` kg m2, all (N,).
    """

    t: Floats
    command: Floats
    reading: Floats
    load: Floats
    slope: Floats
    inertia: Floats

    @cached_property
    def sums(self) -> Floats:
        """Integral (N,) of the command, held from each row to the next."""
        return np.concatenate([[0.0], np.cumsum(self.command[:-1] * np.diff(self.t))])

    def bodies(self, step_s: float) -> Floats:
        """Load, slope, inertia and reading (4, K) at steps of ``step_s``."""
        times = np.arange(self.t[0], self.t[-1], step_s)
        return np.array(
            [np.interp(times, self.t, each) for each in (self.load, self.slope, self.inertia, self.reading)]
        )


@dataclass(frozen=True)
class JointRecord:
    """All episodes of one joint, with what the user's model states of it (``stated (COUNT,)``, see the kernel)."""

    name: str
    episodes: tuple[JointEpisode, ...]
    stated: Floats
    step_s: float
    slides: bool = False

    @cached_property
    def bodies(self) -> list[Floats]:
        """Load, slope, inertia and reading (4, K) of each episode at the steps of the simulation."""
        return [one.bodies(self.step_s) for one in self.episodes]

    @cached_property
    def reading(self) -> Floats:
        """Readings (R,) of all episodes."""
        return np.concatenate([one.reading for one in self.episodes])

    @cached_property
    def command(self) -> Floats:
        """Commands (R,) of all episodes."""
        return np.concatenate([one.command for one in self.episodes])

    @cached_property
    def episode(self) -> Ints:
        """Episode (R,) of each row."""
        return np.repeat(np.arange(len(self.episodes)), [len(one.t) for one in self.episodes])

    @cached_property
    def used(self) -> Bools:
        """Rows (R,) that are compared: not those in which a guessed speed dies out."""
        return np.concatenate([one.t > one.t[0] + SETTLE_S for one in self.episodes])

    @cached_property
    def block(self) -> Ints:
        """Second (R,) of each row, counted on over the episodes."""
        out, first = [], 0
        for one in self.episodes:
            own = ((one.t - one.t[0]) / BLOCK_S).astype(int)
            out.append(first + own)
            first += int(own[-1]) + 1
        return np.concatenate(out)

    @cached_property
    def usual_torque(self) -> float:
        """Torque (N m) that the joint usually needs for its bodies and their motion."""
        return max(float(np.sqrt(np.mean(np.concatenate([one.load for one in self.episodes]) ** 2))), 1e-3)

    @cached_property
    def usual_speed(self) -> float:
        """Speed (rad/s) that it seldom exceeds."""
        speeds = [np.abs(np.gradient(one.command, one.t)) for one in self.episodes if len(one.t) > 2]
        return max(float(np.quantile(np.concatenate(speeds), 0.95)), 1e-3)
