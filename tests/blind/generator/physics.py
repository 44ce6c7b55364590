"""The effects of the library as finite physics on the true arm, from mechanics and the thesis, not from Kilter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]
Act = Callable[[Floats, Deflection], None]

MOST_GROWTH = 1e-4  # 1/K; soft plastics, four times aluminium
NO_MOMENT = 1e-9  # N m; below this a side is rounding, not load
REFERENCE_C = 20.0


@dataclass(frozen=True)
class Physics:
    """An effect on certain joints: ``act(amplitudes (P,), deflection)`` adds it.

    ``names`` are (symbol, joint) with joints from 0 and -1 for the whole arm; ``typical (P,)`` sets the proportions of
    the amplitudes, ``positive`` says that each can only be so; none is more than ``largest``, where nature sets a bound.
    """

    names: tuple[tuple[str, int], ...]
    typical: Floats
    positive: bool
    act: Act
    largest: float = np.inf


def lever(arm: Arm) -> Floats:
    """Length (n,) m from each joint to the stretched tool: what turns an angle into a displacement."""
    lengths = np.linalg.norm(arm.placements[1:, :3, 3], axis=1)
    return np.asarray(np.cumsum(lengths[::-1])[::-1][: arm.n] + 0.05)


def of_angle(arm: Arm, visits: Visits, joints: tuple[int, ...], symbol: str, shape: Floats, positive: bool) -> Physics:
    """Joint angle ``amplitude * shape (V, n)`` at each joint."""

    def act(values: Floats, d: Deflection) -> None:
        for value, j in zip(values, joints, strict=True):
            d.dq[:, j] += value * shape[:, j]

    return Physics(named(symbol, joints), typical(arm, joints, rms(shape)), positive, act)


def _of_two(arm: Arm, joints: tuple[int, ...], angle: Floats) -> Physics:
    """Joint angle a sin + b cos of ``angle (V, n)``."""

    def act(values: Floats, d: Deflection) -> None:
        for k, j in enumerate(joints):
            d.dq[:, j] += values[2 * k] * np.sin(angle[:, j]) + values[2 * k + 1] * np.cos(angle[:, j])

    names = tuple((symbol, j) for j in joints for symbol in ("a", "b"))
    return Physics(names, np.repeat(typical(arm, joints, np.ones(arm.n)), 2), False, act)


def named(symbol: str, joints: tuple[int, ...]) -> tuple[tuple[str, int], ...]:
    """Names of one parameter per joint."""
    return tuple((symbol, j) for j in joints)


def rms(shape: Floats) -> Floats:
    """Size (n,) of the columns of ``shape (V, n)``, never zero."""
    return np.asarray(np.sqrt(np.mean(shape**2, axis=0)) + 1e-12)


def typical(arm: Arm, joints: tuple[int, ...], size: Floats) -> Floats:
    """Amplitudes that displace the tool alike whichever joint has them: the big gears of an arm are its good ones."""
    return np.asarray(1e-4 / (lever(arm) * size)[list(joints)])


def axial_compliance(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The gear gives way to the load about its axis."""
    return of_angle(arm, visits, joints, "c", visits.load.moment[:, :, 2], positive=True)


def backlash(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The arm lags half the play behind its motor: in the library's sign, b s / 2, b is minus the play."""
    return of_angle(arm, visits, joints, "b", visits.direction / 2.0, positive=False)


def friction_windup(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The gear stays wound by what friction holds after the last motion."""
    return of_angle(arm, visits, joints, "k", visits.direction, positive=False)


def backlash_load(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The load about the axis rests the gear on one flank (thesis 5.19)."""
    about = visits.load.moment[:, :, 2]
    side = np.where(np.abs(about) > NO_MOMENT, np.sign(about), 0.0)
    return of_angle(arm, visits, joints, "b", side, positive=True)


def encoder_scale(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The reading counts wrong."""
    return of_angle(arm, visits, joints, "k", visits.q, positive=False)


def joint_coupling(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The first of two joints is carried along by the second, as gears led through a wrist do."""
    driven, driver = joints
    shape = np.zeros_like(visits.q)
    shape[:, driven] = visits.q[:, driver]
    return of_angle(arm, visits, (driven,), "k", shape, positive=False)


def eccentricity(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """A disc or a wheel off its centre: once per turn."""
    return _of_two(arm, joints, visits.q)


def second_harmonic(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """An oval wheel or a coupling: twice per turn."""
    return _of_two(arm, joints, 2.0 * visits.q)


def gear_error(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """Once per turn of the motor."""
    ratio = np.array([g or 1.0 for g in arm.drawn.gear])
    return _of_two(arm, joints, visits.q * ratio)


def radial_compliance(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The bearing gives way to the load across its axis."""
    across = visits.load.moment[:, :, :2]

    def act(values: Floats, d: Deflection) -> None:
        for value, j in zip(values, joints, strict=True):
            d.tilt[:, j, :2] += value * across[:, j]

    size = rms(np.linalg.norm(across, axis=2))
    return Physics(named("c", joints), typical(arm, joints, size), True, act)


def clearance_tilt(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The axis leans in its bearings until it touches (thesis 5.15 corrected, 5.16-5.18), for a bearing of length L."""

    def act(values: Floats, d: Deflection) -> None:
        half = 0.05  # L / 2, m: any length gives the same tilt
        for C, j in zip(values, joints, strict=True):
            x, y = visits.load.moment[:, j, 0], visits.load.moment[:, j, 1]
            total = np.abs(x) + np.abs(y)
            gamma = np.abs(x) * (np.pi / 2.0) / np.where(total > NO_MOMENT, total, 1.0)
            play = half * np.tan(C)
            h, v = play * np.sin(gamma), play * np.cos(gamma)
            loaded = total > NO_MOMENT
            d.tilt[:, j, 0] += np.where(loaded, np.sign(x) * h / np.hypot(half, h), 0.0)
            d.tilt[:, j, 1] += np.where(loaded, np.sign(y) * v / np.hypot(half, v), 0.0)

    return Physics(named("C", joints), typical(arm, joints, np.ones(arm.n)), True, act)


def link_bending(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """Links as cantilevers clamped at their joint: end force, end moment and their own weight at its centre."""
    load = visits.load
    bends, sags = np.zeros_like(load.force), np.zeros_like(load.force)
    for j in joints:
        reach = arm.placements[j + 1, :3, 3]
        L = float(np.linalg.norm(reach))
        if L < 0.03:
            continue
        u = reach / L
        F, M, W = (x[:, j] - np.outer(x[:, j] @ u, u) for x in (load.end_force, load.end_moment, load.weight))
        a = float(np.clip(arm.drawn.com[j] @ u, 0.0, L))
        bends[:, j] = L**2 / 2 * np.cross(u, F) + L * M + a**2 / 2 * np.cross(u, W)
        sags[:, j] = L**3 / 3 * F + L**2 / 2 * np.cross(M, u) + a**2 * (3 * L - a) / 6 * W

    def act(values: Floats, d: Deflection) -> None:
        for value, j in zip(values, joints, strict=True):
            d.bend[:, j] += value * bends[:, j]
            d.sag[:, j] += value * sags[:, j]

    size = rms(np.linalg.norm(bends, axis=2))
    return Physics(named("1/EI", joints), typical(arm, joints, size), True, act)


def gravity_spring(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """A balancing spring between column and upper arm winds the gear it relieves; short at rest, as they are made."""
    j = joints[0]
    pivot, link, rest = 0.3, 0.12, 0.04
    angle = np.pi - (visits.q[:, j] - arm.drawn.neutral)
    length = np.sqrt(pivot**2 + link**2 - 2.0 * pivot * link * np.cos(angle))
    shape = np.zeros_like(visits.q)
    shape[:, j] = pivot * link * np.sin(angle) * (1.0 - rest / length)
    return of_angle(arm, visits, joints, "ck", shape, positive=False)


def base_compliance(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The pedestal leans under the moment on the foot."""
    moment = visits.load.base[:, :2]

    def act(values: Floats, d: Deflection) -> None:
        d.base[:, 3:5] += values * moment

    return Physics((("cx", -1), ("cy", -1)), 1e-4 / (rms(moment) * lever(arm)[0]), True, act)


def thermal_growth(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """Every link grows with the temperature above 20 C."""

    def act(values: Floats, d: Deflection) -> None:
        d.growth += values[0] * (visits.temperature_c - REFERENCE_C)[:, None]

    return Physics((("alpha", -1),), np.array([12e-6]), True, act, MOST_GROWTH)


def drift(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The foot moves and turns steadily against the tracker."""
    hours = (visits.t_s - visits.t_s[0]) / 3600.0

    def act(values: Floats, d: Deflection) -> None:
        d.base += hours[:, None] * values

    names = tuple((k, -1) for k in ("vx", "vy", "vz", "wx", "wy", "wz"))
    return Physics(names, np.repeat([1e-4, 1e-4 / lever(arm)[0]], 3), False, act)


def measurement_scale(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The tracker's millimetre is not one."""

    def act(values: Floats, d: Deflection) -> None:
        d.scale += values[0]

    return Physics((("k", -1),), np.array([2e-5]), False, act)


def session_shift(arm: Arm, visits: Visits, joints: tuple[int, ...]) -> Physics:
    """The reflector was put on anew before each session after the first."""
    later = range(1, int(visits.session.max()) + 1)

    def act(values: Floats, d: Deflection) -> None:
        for k, s in enumerate(later):
            d.tool[visits.session == s] += values[3 * k : 3 * k + 3]

    names = tuple((f"{k}{s + 1}", -1) for s in later for k in "xyz")
    return Physics(names, np.full(len(names), 1e-4), False, act)


PER_JOINT = {
    f.__name__: f
    for f in (
        clearance_tilt, backlash, backlash_load, axial_compliance, radial_compliance, eccentricity, second_harmonic,
        gear_error, encoder_scale, link_bending, friction_windup,
    )
}  # fmt: skip
WHOLE_ARM = {f.__name__: f for f in (base_compliance, thermal_growth, drift, measurement_scale, session_shift)}
