"""Causes that are easily mistaken for others: zeros that drift, single links that grow, stiffness that is not constant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import GRAVITY, Arm, Deflection
from tests.blind.generator.physics import MOST_GROWTH, REFERENCE_C, Physics, lever, named, of_angle, rms, typical
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]

TAU = 0.25  # usual time constant of a settling, in campaigns
KNOTS = 6  # of a wandering foot that a model follows
TWIST = ("x", "y", "z", "wx", "wy", "wz")


def zero_drift(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The zero of a joint creeps with the clock: a coupling that slips, a belt that stretches."""
    shape = np.repeat((visits.t_s - visits.t_s[0])[:, None], arm.n, axis=1)
    return of_angle(arm, visits, joints, "r", shape, positive=False)


def zero_thermal(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The zero of a joint moves with the temperature: the carrier of its encoder grows."""
    shape = np.repeat((visits.temperature_c - REFERENCE_C)[:, None], arm.n, axis=1)
    return of_angle(arm, visits, joints, "k", shape, positive=False)


def link_growth(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """Only the link after a joint grows: a warm motor sits in it."""
    kelvin = visits.temperature_c - REFERENCE_C

    def act(values: Floats, d: Deflection) -> None:
        for value, j in zip(values, joints, strict=True):
            d.growth[:, j + 1] += value * kelvin

    return Physics(named("alpha", joints), np.full(len(joints), 23e-6), True, act, MOST_GROWTH)


def hardening(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """A gear that gives way less the more it is loaded: what it falls short of its own stiffness, -h eta |eta|."""
    about = visits.load.moment[:, :, 2]
    return of_angle(arm, visits, joints, "h", -about * np.abs(about), positive=True)


def direction_compliance(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """A gear stiffer on one flank than on the other: the side it was approached from decides."""
    return of_angle(arm, visits, joints, "h", visits.direction * visits.load.moment[:, :, 2], positive=False)


def reading_tilt(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The disc of the encoder tilts with the axis under the load across it, and the reading with it."""
    across = visits.load.moment[:, :, :2]

    def act(values: Floats, d: Deflection) -> None:
        for k, j in enumerate(joints):
            d.dq[:, j] += across[:, j] @ values[2 * k : 2 * k + 2]

    names = tuple((symbol, j) for j in joints for symbol in ("kx", "ky"))
    size = np.repeat(typical(arm, joints, rms(np.linalg.norm(across, axis=2))), 2)
    return Physics(names, size, False, act)


def settling(arm: Arm, visits: Visits, joints: tuple[int, ...], tau: float = TAU) -> Physics:
    """The foot, or the tracker, comes to rest after it was set up: 1 - exp(-t / tau), tau in campaigns."""
    t = visits.t_s - visits.t_s[0]
    return twist(arm, 1.0 - np.exp(-t / (tau * max(float(t[-1]), 1.0))))


def twist(arm: Arm, course: Floats) -> Physics:
    """The foot moves and turns along ``course (V,)``."""

    def act(values: Floats, d: Deflection) -> None:
        d.base += course[:, None] * values

    size = np.repeat([1e-4, 1e-4 / lever(arm)[0]], 3)
    return Physics(tuple((k, -1) for k in TWIST), size, False, act)


def random_walk(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator | None = None) -> Physics:
    """The foot, or the tracker, wanders: a random walk, smooth enough to be followed; without ``rng`` every such walk.

    A walk has three amplitudes; all walks together are straight lines between knots, three parameters at each.
    """
    x = (visits.t_s - visits.t_s[0]) / max(float(np.ptp(visits.t_s)), 1.0)
    if rng is None:
        knots = np.linspace(0.0, 1.0, KNOTS)
        shapes = np.stack([np.interp(x, knots, row) for row in np.eye(KNOTS)], axis=1)
        columns = np.einsum("vk,ij->vkij", shapes, np.eye(3)).reshape(len(x), 3 * KNOTS, 3)
    else:
        columns = np.einsum("vi,ij->vij", _walk(x, rng), np.eye(3))

    def act(values: Floats, d: Deflection) -> None:
        d.base[:, :3] += np.einsum("vpi,p->vi", columns, values)

    names = tuple((f"{'xyz'[k % 3]}{k // 3}", -1) for k in range(columns.shape[1]))
    return Physics(names, np.full(len(names), 1e-4), False, act)


def _walk(x: Floats, rng: np.random.Generator) -> Floats:
    """Three walks (V, 3) over ``x`` from 0 to 1, of size 1, their steps smoothed."""
    fine = np.linspace(0.0, 1.0, 200)
    steps = rng.normal(size=(200, 3))
    window = np.hanning(31)
    path = np.stack([np.convolve(np.cumsum(c), window / window.sum(), mode="same") for c in steps.T], axis=1)
    path -= path.mean(axis=0)
    path /= path.std(axis=0)
    return np.stack([np.interp(x, fine, c) for c in path.T], axis=1)


def column_bending(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The column the arm stands on bends with the temperature: the sun on one side of it."""
    kelvin = visits.temperature_c - REFERENCE_C

    def act(values: Floats, d: Deflection) -> None:
        d.base[:, 3:5] += kelvin[:, None] * values

    return Physics((("kx", -1), ("ky", -1)), np.full(2, 1e-4 / (3.0 * lever(arm)[0])), False, act)


def tool_sag(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The adapter of the reflector sags under the payload, across its own axis (z of the tool): metres per kg."""
    R = arm.placements[-2][:3, :3] @ arm.placements[-1][:3, :3]
    down = visits.load.end_force[:, -1] / GRAVITY @ R  # kg, along gravity

    def act(values: Floats, d: Deflection) -> None:
        d.tool[:, :2] += values[0] * down[:, :2]

    return Physics((("s", -1),), np.array([1e-4 / max(arm.drawn.payload_kg, 1e-3)]), True, act)


def payload_error(arm: Arm, visits: Visits, joints: tuple[int, ...], compliance: float) -> Physics:
    """The payload is heavier than told, as the compliance of one joint shows: kilograms."""
    j = joints[0]
    loaded = (visits.payload_kg > 0.0).astype(np.float64)
    more = arm.load(visits.q, loaded).moment[:, j, 2] - arm.load(visits.q, np.zeros(len(visits))).moment[:, j, 2]

    def act(values: Floats, d: Deflection) -> None:
        d.dq[:, j] += compliance * values[0] * more

    return Physics((("mass", -1),), np.array([0.3 * arm.drawn.payload_kg]), False, act)
