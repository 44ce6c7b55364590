"""Logs of a moving arm in which an effect is hidden: Pinocchio's dynamics with friction of the tests' own.

Nothing here imports the core. Truth is computed ten times as finely as it is logged, positions are encoder counts, torques have
noise that is not white, and friction is LuGre's bristle without its states: tanh is not used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from tests.core.truth import Arm, Body, Floats, dh_steps, ur10

RIGHT = np.pi / 2
COUNT_RAD = 2e-5
Extra = Callable[["State"], Floats]


@dataclass(frozen=True)
class State:
    """Joints, speeds, accelerations, and what rigid bodies need, (N, n); seconds since the start of the log (N,)."""

    q: Floats
    qd: Floats
    qdd: Floats
    rigid: Floats
    seconds: Floats


@dataclass(frozen=True)
class Friction:
    """Of every joint: Coulomb and viscous as shares of its usual torque, softly reversed."""

    coulomb: Floats
    viscous: Floats
    reverse_rad_s: float = 0.004

    def torque(self, state: State) -> Floats:
        return self.coulomb * reversed_softly(state.qd, self.reverse_rad_s) + self.viscous * state.qd


def reversed_softly(qd: Floats, width: float) -> Floats:
    """A sign that turns within ``width``."""
    return np.asarray(qd / np.sqrt(qd**2 + width**2))


def ur_like(rng: np.random.Generator) -> Arm:
    """A six-joint arm of the size of a UR10 with bodies of its own."""
    masses = (7.0, 12.5, 4.0, 2.0, 2.0, 0.4)
    centres = ((0, 0, 0), (-0.3, 0, 0.1), (-0.25, 0, 0.02), (0, 0, 0.01), (0, 0, 0.01), (0, 0, -0.02))
    bodies = []
    for j, (mass, centre) in enumerate(zip(masses, centres, strict=True)):
        com = np.array(centre) + rng.normal(0.0, 0.01, 3)
        inertia = np.diag(mass * rng.uniform(0.002, 0.02, 3))
        bodies.append(Body(j, mass * rng.uniform(0.9, 1.1), com, inertia))
    return ur10(bodies=tuple(bodies))


def seven_like(rng: np.random.Generator) -> Arm:
    """A seven-joint arm of shoulder, elbow and wrist."""
    rows = [(0.34, 0.0, -RIGHT), (0.0, 0.0, RIGHT), (0.4, 0.0, RIGHT), (0.0, 0.0, -RIGHT), (0.4, 0.0, -RIGHT),
            (0.0, 0.0, RIGHT), (0.126, 0.0, 0.0)]  # fmt: skip
    bodies = tuple(
        Body(j, m, rng.normal(0.0, 0.05, 3), np.diag(m * rng.uniform(0.003, 0.02, 3)))
        for j, m in enumerate((4.0, 4.0, 3.0, 2.7, 1.7, 1.8, 0.5))
    )
    return Arm(dh_steps(rows), 7, bodies=bodies)


@dataclass
class Logger:
    """An arm that moves, and what its controller logs of it; torques in N m, angles in rad."""

    arm: Arm
    seed: int = 0
    hz: float = 100.0
    motions: int = 6
    seconds: float = 20.0
    noise_share: float = 0.02  # of the rms of each torque
    motor_inertia: Floats | None = None
    extra: list[Extra] = field(default_factory=list)
    delay_s: Floats | None = None
    gain: Floats | None = None

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.usual = np.array([20.0, 40.0, 15.0, 3.0, 3.0, 1.5, 1.0])[: self.arm.n]
        self.friction = Friction(
            0.15 * self.usual * self.rng.uniform(0.7, 1.3, self.arm.n),
            0.1 * self.usual * self.rng.uniform(0.5, 1.5, self.arm.n),
        )

    def log(self) -> dict[str, Floats]:
        """Columns t (N,), q and tau (N, n), motion (N,): motions are a minute apart."""
        parts = [self._follow_element(k) for k in range(self.motions)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _follow_element(self, k: int) -> dict[str, Floats]:
        fine = 1.0 / (4 * self.hz)
        t = np.arange(0.0, self.seconds, fine)
        q, qd, qdd = self._path(t)
        state = State(q, qd, qdd, self._rigid(q, qd, qdd), t + k * (self.seconds + 60.0))
        tau = state.rigid + self.friction.torque(state)
        if self.motor_inertia is not None:
            tau = tau + self.motor_inertia * qdd
        for extra in self.extra:
            tau = tau + extra(state)
        if self.gain is not None:
            tau = tau * self.gain
        if self.delay_s is not None:
            tau = np.stack([np.interp(t - d, t, one) for d, one in zip(self.delay_s, tau.T, strict=True)], axis=1)
        tau = tau[::4] + self._noise(len(t[::4]))
        counted = COUNT_RAD * np.round(q[::4] / COUNT_RAD)
        return {"t": state.seconds[::4], "q": counted, "tau": tau, "motion": np.full(len(counted), float(k))}

    def _noise(self, rows: int) -> Floats:
        """Noise that remembers: of first order over 30 ms."""
        white = self.rng.normal(size=(rows, self.arm.n))
        out, keep = np.empty_like(white), np.exp(-1.0 / (0.03 * self.hz))
        out[0] = white[0]
        for i in range(1, rows):
            out[i] = keep * out[i - 1] + np.sqrt(1 - keep**2) * white[i]
        return self.noise_share * self.usual * out

    def _path(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Sums of five waves of each joint about a place of its own."""
        n = self.arm.n
        centre = self.rng.uniform(-0.6, 0.6, n)
        q, qd, qdd = np.tile(centre, (len(t), 1)), np.zeros((len(t), n)), np.zeros((len(t), n))
        for _ in range(5):
            w = 2 * np.pi * self.rng.uniform(0.04, 0.35, n)
            a, phase = self.rng.uniform(0.1, 0.35, n), self.rng.uniform(0, 2 * np.pi, n)
            angle = np.outer(t, w) + phase
            q, qd, qdd = q + a * np.sin(angle), qd + a * w * np.cos(angle), qdd - a * w**2 * np.sin(angle)
        return q, qd, qdd

    def _rigid(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        model, _ = self.arm.pinocchio()
        data = model.createData()
        rows = zip(self.arm.motors(q), self.arm.rates(qd), self.arm.rates(qdd), strict=True)
        return np.array([pin.rnea(model, data, *row) for row in rows])
