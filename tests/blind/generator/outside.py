"""Physics that no library lists: what a finder must leave without a name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.physics import Physics, lever
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]


def _curve(arm: Arm, joint: int, shapes: Floats, symbols: str) -> Physics:
    """Joint angle as a sum of ``shapes (P, V)``."""

    def act(values: Floats, d: Deflection) -> None:
        d.dq[:, joint] += values @ shapes

    return Physics(tuple((s, joint) for s in symbols), np.full(len(shapes), 1e-4 / lever(arm)[joint]), False, act)


def third_harmonic(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator) -> Physics:
    """Three times per turn."""
    q = 3.0 * visits.q[:, joints[0]]
    return _curve(arm, joints[0], np.stack([np.sin(q), np.cos(q)]), "ab")


def local_bump(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator) -> Physics:
    """A worn or dented place of the gear, 10 to 20 degrees wide, somewhere the joint often passes."""
    q = visits.q[:, joints[0]]
    centre = rng.uniform(*np.quantile(q, [0.25, 0.75]))
    width = np.radians(rng.uniform(10.0, 20.0))
    return _curve(arm, joints[0], np.exp(-0.5 * ((q - centre) / width) ** 2)[None], "h")


def sine_product(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator) -> Physics:
    """Two joints that disturb one another: sin q_a sin q_b at joint a."""
    a, b = joints
    return _curve(arm, a, (np.sin(visits.q[:, a]) * np.sin(visits.q[:, b]))[None], "h")


def workspace_field(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator) -> Physics:
    """A smooth field of displacements, as of bent light or a bent floor: a few waves longer than half the reach."""
    nominal = (arm.positions(visits.q) - arm.foot[:3, 3]) @ arm.foot[:3, :3]
    field = np.zeros_like(nominal)
    for _ in range(4):
        k = rng.normal(size=3)
        k *= 2.0 * np.pi / (rng.uniform(0.5, 1.2) * lever(arm)[0] * np.linalg.norm(k))
        field += rng.normal(size=3) * np.sin(nominal @ k + rng.uniform(0.0, 2.0 * np.pi))[:, None]

    def act(values: Floats, d: Deflection) -> None:
        d.field += values[0] * field

    return Physics((("h", -1),), np.array([1e-4]), False, act)


def stick_slip(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator) -> Physics:
    """The joint stops somewhere else at every approach."""
    return _curve(arm, joints[0], rng.normal(size=(1, len(visits))), "h")


OUTSIDE = {f.__name__: f for f in (third_harmonic, local_bump, sine_product, workspace_field, stick_slip)}
