"""The effects of the library together: those of one joint, those of the whole arm, and how the supple ones are built."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator import causes, physics
from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.physics import Physics, lever
from tests.blind.generator.visits import Visits

Candidate = tuple[str, tuple[int, ...], Physics]

PER_JOINT = physics.PER_JOINT | {
    f.__name__: f
    for f in (
        causes.zero_drift, causes.zero_thermal, causes.link_growth, causes.hardening, causes.direction_compliance,
        causes.reading_tilt,
    )
}  # fmt: skip
WHOLE_ARM = physics.WHOLE_ARM | {
    f.__name__: f for f in (causes.settling, causes.random_walk, causes.column_bending, causes.tool_sag)
}
LIBRARY = {**PER_JOINT, "joint_coupling": physics.joint_coupling, "gravity_spring": physics.gravity_spring, **WHOLE_ARM}
CURVE = "unknown_joint_curve"  # a smooth curve of one joint, which names no cause
TAUS = (0.12, 0.25, 0.45)


def library(arm: Arm, visits: Visits) -> Iterator[Candidate]:
    """Every candidate: each joint, all joints, couplings, the whole arm, and smooth curves without a name."""
    everywhere = tuple(range(arm.n))
    for name, build in PER_JOINT.items():
        for joints in [*((j,) for j in everywhere), everywhere]:
            yield name, joints, build(arm, visits, joints)
    for pair in [(a, b) for a in everywhere for b in (a - 1, a - 2) if b >= 0]:
        yield "joint_coupling", pair, physics.joint_coupling(arm, visits, pair)
    yield "gravity_spring", (1,), physics.gravity_spring(arm, visits, (1,))
    for name, build in WHOLE_ARM.items():
        yield name, (), build(arm, visits, ())
    for tau in TAUS:
        yield "settling", (), causes.settling(arm, visits, (), tau)
    yield from _curves(arm, visits)


def _curves(arm: Arm, visits: Visits) -> Iterator[Candidate]:
    """Smooth curves of joints that moved less than a turn: without and with the straight line, which is a scale."""
    for j in range(arm.n):
        q = visits.q[:, j]
        if np.ptp(q) >= 2.0 * np.pi:
            continue
        x = (q - q.mean()) / max(float(np.ptp(q)) / 2.0, 1e-9)
        for orders in ((2, 3), (1, 2, 3)):
            yield CURVE, (j,), curve(arm, j, np.stack([x**k for k in orders]), tuple(f"c{k}" for k in orders))


def curve(arm: Arm, joint: int, shapes: NDArray[np.float64], symbols: tuple[str, ...]) -> Physics:
    """Joint angle as a sum of ``shapes (P, V)``."""

    def act(values: NDArray[np.float64], d: Deflection) -> None:
        d.dq[:, joint] += values @ shapes

    names = tuple((s, joint) for s in symbols)
    return Physics(names, np.full(len(shapes), 1e-4 / lever(arm)[joint]), False, act)
