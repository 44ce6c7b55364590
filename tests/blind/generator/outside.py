"""Physics that no library lists: what a finder must leave without a name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.library import curve
from tests.blind.generator.physics import Physics, lever
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]
Rng = np.random.Generator

BELTS = (0.6, 1.37)  # turns of a belt to one of its joint


def third_harmonic(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """Three times per turn."""
    q = 3.0 * visits.q[:, joints[0]]
    return curve(arm, joints[0], np.stack([np.sin(q), np.cos(q)]), ("a", "b"))


def local_bump(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """A worn or dented place of the gear, 10 to 20 degrees wide, somewhere the joint often passes."""
    low, high = visits.box[joints[0]]
    centre = low + (high - low) * rng.uniform(0.25, 0.75)
    width = np.radians(rng.uniform(10.0, 20.0))
    return curve(arm, joints[0], np.exp(-0.5 * ((visits.q[:, joints[0]] - centre) / width) ** 2)[None], ("h",))


def sine_product(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """Two joints that disturb one another: sin q_a sin q_b at joint a."""
    a, b = joints
    return curve(arm, a, (np.sin(visits.q[:, a]) * np.sin(visits.q[:, b]))[None], ("h",))


def hose_torque(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """A dress pack winds up with the joint and pulls it back, ever harder: a q^3 + b q from the middle of its range."""
    x = _centred(visits, joints[0])
    return curve(arm, joints[0], (x**3 + rng.uniform(0.0, 0.5) * x)[None], ("a",))


def quadratic_curve(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """A hose that pulls to one side at both ends."""
    return curve(arm, joints[0], (_centred(visits, joints[0]) + rng.uniform(-0.3, 0.3))[None] ** 2, ("a",))


def spline_curve(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """A smooth curve of no form: a spline through random values at five knots of the range."""
    spline = CubicSpline(np.linspace(-1.0, 1.0, 5), rng.normal(size=5), bc_type="natural")
    return curve(arm, joints[0], spline(_centred(visits, joints[0]))[None], ("h",))


def belt_error(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """A belt that repeats after no whole number of turns of its joint."""
    q = float(rng.choice(BELTS)) * visits.q[:, joints[0]]
    return curve(arm, joints[0], np.stack([np.sin(q), np.cos(q)]), ("a", "b"))


def _centred(visits: Visits, joint: int) -> Floats:
    """Readings of a joint from -1 to 1 over its range."""
    low, high = visits.box[joint]
    return np.asarray((visits.q[:, joint] - (low + high) / 2.0) / ((high - low) / 2.0))


def azimuth_error(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """The tracker's circles are off their centres: both angles err once and twice per turn."""
    p = arm.positions(visits.q)
    flat = np.hypot(p[:, 0], p[:, 1])
    azimuth, elevation = np.arctan2(p[:, 1], p[:, 0]), np.arctan2(p[:, 2], flat)
    around = np.stack([-p[:, 1], p[:, 0], np.zeros(len(p))], axis=1)
    upward = np.stack([-p[:, 2] * p[:, 0] / flat, -p[:, 2] * p[:, 1] / flat, flat], axis=1)
    parts = [f(k * angle)[:, None] * to for angle, to in ((azimuth, around), (elevation, upward)) for k in (1, 2)
             for f in (np.sin, np.cos)]  # fmt: skip
    columns = np.stack(parts, axis=1) @ arm.foot[:3, :3]

    def act(values: Floats, d: Deflection) -> None:
        d.field += np.einsum("vpi,p->vi", columns, values)

    names = tuple((f"{kind}{k}{f}", -1) for kind in ("az", "el") for k in (1, 2) for f in "sc")
    return Physics(names, np.full(8, 2e-5), False, act)


def workspace_field(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
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


def stick_slip(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: Rng) -> Physics:
    """The joint stops somewhere else at every approach."""
    return curve(arm, joints[0], rng.normal(size=(1, len(visits))), ("h",))


SMOOTH = {f.__name__: f for f in (hose_torque, quadratic_curve, spline_curve, belt_error)}
OUTSIDE = SMOOTH | {
    f.__name__: f for f in (third_harmonic, local_bump, sine_product, workspace_field, stick_slip, azimuth_error)
}
