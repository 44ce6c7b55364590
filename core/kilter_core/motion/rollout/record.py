"""What a joint was told and what it read, with the bodies it moves, on the grid on which it is simulated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import savgol_filter

from kilter_core.motion.kernels import joint as place
from kilter_core.types import Bools, Floats, Ints

BLOCK_S = 1.0  # a second is one observation
SMOOTH_S = 0.16  # over which a motion is taken from readings
SETTLE_S = 0.3  # from the start of an episode, by which angle and speed at its start are found


def grid_times(t: Floats, step_s: float) -> Floats:
    """Times (K,) of the steps of a simulation of rows at ``t (N,)``."""
    return np.arange(t[0], t[-1], step_s, dtype=np.float64)


def smooth_motion(t: Floats, values: Floats, step_s: float) -> Floats:
    """Values, speeds and accelerations (3, K) at the steps of a simulation, by cubics (Savitzky and Golay 1964)."""
    dt = float(np.median(np.diff(t)))
    width = min(max(5, round(SMOOTH_S / dt) | 1), (len(t) - 1) | 1)
    times = grid_times(t, step_s)
    return np.array([np.interp(times, t, savgol_filter(values, width, 3, deriv=k, delta=dt)) for k in range(3)])


@dataclass(frozen=True)
class JointEpisode:
    """An episode of one joint: ``t``, ``command`` and ``reading`` (N,) in s and rad (m).

    ``bodies (4, K)`` stand at the steps of the simulation: the load of its bodies N m, its slope N m/rad, their inertia
    kg m2, and the angle at which the load is taken.
    """

    t: Floats
    command: Floats
    reading: Floats
    bodies: Floats

    @cached_property
    def sums(self) -> Floats:
        """Integral (N,) of the command, held from each row to the next."""
        return np.concatenate([[0.0], np.cumsum(self.command[:-1] * np.diff(self.t))])


@dataclass(frozen=True)
class JointRecord:
    """All episodes of one joint, with what the user's model states of it (``stated (COUNT,)``, see the kernel).

    ``correction (R,)`` is what the whole arm in its simulator reads beyond the joint simulated by itself.
    """

    name: str
    episodes: tuple[JointEpisode, ...]
    stated: Floats
    step_s: float
    slides: bool = False
    correction: Floats | None = None

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
        """Rows (R,) that are compared: not those by which the start of an episode is found."""
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
    def inertia(self) -> float:
        """Mean inertia (kg m2) of its bodies."""
        return float(np.mean(np.concatenate([one.bodies[2] for one in self.episodes])))

    @cached_property
    def usual_torque(self) -> float:
        """Torque (N m) that the joint usually needs for its bodies and their motion."""
        return max(float(np.sqrt(np.mean(np.concatenate([one.bodies[0] for one in self.episodes]) ** 2))), 1e-3)

    @cached_property
    def usual_speed(self) -> float:
        """Speed (rad/s) that it seldom exceeds."""
        speeds = [np.abs(np.gradient(one.command, one.t)) for one in self.episodes if len(one.t) > 2]
        return max(float(np.quantile(np.concatenate(speeds), 0.95)), 1e-3)


@dataclass(frozen=True)
class Servo:
    """Armature kg m2, friction N m, damping N m s/rad of joint and servo, gain N m/rad, and the limit of its torque, 0: none.

    ``impedance`` and ``rate`` 1/s are those of MuJoCo's friction; a rate of 0 holds without creep. ``delay`` s is that of the
    command.
    """

    armature: float
    friction: float
    joint_damping: float
    servo_damping: float
    gain: float
    torque_limit: float = 0.0
    impedance: float = 1.0
    rate: float = 0.0
    delay: float = 0.0

    def numbers(self) -> Floats:
        """Numbers (COUNT,) of a joint that has nothing else."""
        p = np.zeros(place.COUNT)
        damping = self.joint_damping + self.servo_damping
        p[place.ARMATURE], p[place.FRICTION], p[place.DAMPING] = self.armature, self.friction, damping
        p[place.GAIN], p[place.TORQUE_LIMIT], p[place.COMMAND_DELAY] = self.gain, self.torque_limit, self.delay
        p[place.SERVO_SHARE] = self.servo_damping / damping if damping > 0.0 else 0.0
        p[place.IMPEDANCE], p[place.RATE], p[place.SLIP_SPEED] = self.impedance, self.rate, 1.0
        return p
