"""An elbow arm whose zeros are degrees off, measured with effects that follow loads: the blind generator's arithmetic.

Loads are Pinocchio's on the arm as it stands, so nothing here is computed by what is tested.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.observations import Observations
from tests.blind.generator import Options
from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.arms import Drawn, elbow
from tests.blind.generator.library import LIBRARY
from tests.blind.generator.rigid import about_z
from tests.blind.generator.visits import Visits, plan

Floats = NDArray[np.float64]

ZEROS_DEG = (0.7, 2.2, -1.8, 1.5, -2.1, 0.4)
NOISE_M = 1e-5
Amounts = Mapping[str, tuple[tuple[int, ...], tuple[float, ...]]]  # effect: joints from 0, amplitudes SI


@dataclass(frozen=True)
class OffZero:
    """An arm, as drawn and as it stands; ``amounts`` of effects act on it."""

    drawn: Drawn
    amounts: Amounts
    zeros_deg: tuple[float, ...] = ZEROS_DEG

    @property
    def arm(self) -> Arm:
        """The arm with its zeros off, its foot a metre from the instrument."""
        nominal = Arm.nominal(self.drawn)
        placements = nominal.placements.copy()
        placements[: nominal.n] = placements[: nominal.n] @ about_z(np.radians(self.zeros_deg))
        foot = np.eye(4)
        foot[:3, 3] = 1.0, -0.4, 0.3
        return replace(nominal, placements=placements, foot=foot)

    @property
    def robot(self) -> Robot:
        """What Kilter is told: the arm as drawn, its masses right."""
        return robot_from_document(self.drawn.document(self.drawn.mass))

    def rows(self, poses: int, seed: int, noise_m: float = NOISE_M) -> Observations:
        """Measured positions of random poses, two in five visited twice."""
        rng = np.random.default_rng(seed)
        visits = plan(self.arm, poses, Options(), rng)
        position = self.points(visits)
        return Observations(
            q=visits.q, position=position + noise_m * rng.standard_normal(position.shape), direction=visits.direction,
            payload_kg=visits.payload_kg, pose_id=visits.pose,
        )  # fmt: skip

    def points(self, visits: Visits) -> Floats:
        """Tool points (V, 3) m of the arm as its loads deflect it."""
        bent = Deflection.none(len(visits), self.drawn.n)
        for name, (joints, values) in self.amounts.items():
            LIBRARY[name](self.arm, visits, joints).act(np.array(values), bent)
        return self.arm.positions(visits.q, bent)


def soft_elbow(**amounts: tuple[tuple[int, ...], tuple[float, ...]]) -> OffZero:
    """The elbow arm with these effects."""
    return OffZero(elbow(), amounts)
