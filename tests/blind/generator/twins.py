"""Causes that follow a clock as members of the library do, and are none of them: what they are called says where it acts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.physics import REFERENCE_C, Physics, lever, named
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]
Rng = np.random.Generator


def zero_settling(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """The carrier of an encoder warms up: the zero of its joint settles."""
    course = _settled(visits, rng)

    def act(values: Floats, d: Deflection) -> None:
        d.dq[:, joints[0]] += values[0] * course

    return Physics(named("e", joints), np.array([1e-4 / lever(arm)[joints[0]]]), False, act)


def link_lag(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """A thick link warms later than the thermometer says, by a tenth to a third of the campaign."""
    t = visits.t_s - visits.t_s[0]
    tau, kelvin = rng.uniform(0.1, 0.3) * max(float(t[-1]), 1.0), visits.temperature_c - REFERENCE_C
    lagged = np.full_like(kelvin, kelvin[0])
    for k in range(1, len(t)):
        lagged[k] = kelvin[k] + (lagged[k - 1] - kelvin[k]) * np.exp(-(t[k] - t[k - 1]) / tau)

    def act(values: Floats, d: Deflection) -> None:
        d.growth[:, joints[0] + 1] += values[0] * lagged

    return Physics(named("alpha", joints), np.array([23e-6]), True, act)


def link_bow(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """The sun comes onto one side of a link, which bends: its end turns about an axis across it, and moves aside."""
    j, course = joints[0], _settled(visits, rng)
    reach = arm.placements[j + 1, :3, 3]
    along = reach / max(float(np.linalg.norm(reach)), 1e-9)
    across = np.cross(along, rng.normal(size=3))
    across /= np.linalg.norm(across)

    def act(values: Floats, d: Deflection) -> None:
        d.bend[:, j] += values[0] * course[:, None] * across
        d.sag[:, j] += values[0] * course[:, None] * np.cross(across, reach) / 2.0

    return Physics(named("b", joints), np.array([1e-4 / lever(arm)[j]]), False, act)


def air_scale(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """The air between tracker and arm warms up where no thermometer is: the distances are read too short."""
    course = _settled(visits, rng)

    def act(values: Floats, d: Deflection) -> None:
        d.scale += values[0] * course

    return Physics((("s", -1),), np.array([1e-5]), False, act)


def _settled(visits: Visits, rng: Rng) -> Floats:
    """1 - exp(-t / tau) (V,), with tau from a tenth to a half of the campaign."""
    t = visits.t_s - visits.t_s[0]
    return np.asarray(1.0 - np.exp(-t / (rng.uniform(0.1, 0.5) * max(float(t[-1]), 1.0))))


TWINS = {f.__name__: f for f in (zero_settling, link_lag, link_bow, air_scale)}
