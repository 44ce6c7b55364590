"""A UR10 with errors and two soft gears under a tracker that stands far away: Pinocchio's arithmetic, none of the core's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from tests.core.truth import Arm, Body, ur10

Floats = NDArray[np.float64]

NOISE_M = 1e-5
PAYLOADS = (0.0, 5.0)
TURN = np.radians(37.0) * np.array([0.3, -0.4, np.sqrt(0.75)])  # about a tilted axis
TRACKER = pin.SE3(pin.exp3(TURN), np.array([1.6, -1.1, 0.5]))  # 2 m away
TOOL = pin.SE3(np.eye(3), np.array([0.06, 0.0, 0.1]))
REFLECTOR = TOOL * pin.SE3(np.eye(3), np.array([0.03, -0.015, 0.01]))  # it does not sit where the tool is drawn
ERRORS = {
    "d_1": 4e-4, "theta_offset_2": 1.2e-3, "a_2": 5e-4, "theta_offset_3": -9e-4, "a_3": -4e-4, "d_4": 3e-4,
    "alpha_4": 8e-4, "theta_offset_4": 7e-4, "alpha_5": -6e-4, "theta_offset_5": -1e-3, "d_5": 2e-4,
}  # fmt: skip
COMPLIANCE = np.array([0.0, 8e-6, 8e-6, 0.0, 0.0, 0.0])  # rad/(N m)


@dataclass(frozen=True)
class Scene:
    """An arm as drawn, the arm as built where the tracker sees it, and rows of both."""

    drawn: Arm
    built: Arm
    q: Floats
    payload_kg: Floats
    direction: Floats
    pose: NDArray[np.int64]
    measured: Floats

    def points(self, q: Floats, payload_kg: Floats | None = None) -> Floats:
        """Tool points (N, 3) m of the built arm in the tracker's frame, its gears giving way to the load."""
        loads = np.zeros(len(q)) if payload_kg is None else payload_kg
        torques = np.zeros_like(q)
        for kg in np.unique(loads):
            torques[loads == kg] = self.drawn.torques(q[loads == kg], payload=(kg, np.zeros(3)))
        return self.built.poses(q - COMPLIANCE * torques)[0]

    def columns(self) -> dict[str, list[float]]:
        """The rows as they are uploaded."""
        out = {f"q{j + 1}_deg": np.degrees(self.q[:, j]).tolist() for j in range(6)}
        out |= {f"dir{j + 1}": self.direction[:, j].tolist() for j in range(6)}
        out |= {f"{axis}_mm": (1e3 * self.measured[:, k]).tolist() for k, axis in enumerate("xyz")}
        return out | {"payload_kg": self.payload_kg.tolist(), "pose_id": self.pose.tolist()}


def scene(seed: int = 3, poses: int = 90, again: int = 30) -> Scene:
    """Random poses under two payloads, the first ``again`` of them three times."""
    masses, places = (7.8, 12.9, 3.9, 2.0, 2.0, 0.4), ((0, 0, 0), (-0.3, 0, 0.14), (-0.28, 0, 0.05), *[(0, 0, 0)] * 3)
    bodies = tuple(Body(j, m, np.array(c, dtype=float)) for j, (m, c) in enumerate(zip(masses, places, strict=True)))
    drawn = ur10(bodies=bodies, tool=TOOL)
    built = replace(drawn.moved(ERRORS), base=TRACKER, tool=REFLECTOR)
    rng = np.random.default_rng(seed)
    pose = np.concatenate([np.arange(poses), np.tile(np.arange(again), 2)])
    q = rng.uniform(-2.0, 2.0, (poses, 6))[pose]
    side = rng.choice([-1.0, 1.0], (poses, 6))[pose]
    made = Scene(drawn, built, q, rng.choice(PAYLOADS, poses)[pose], side, pose, np.zeros((len(q), 3)))
    return replace(made, measured=made.points(q, made.payload_kg) + NOISE_M * rng.standard_normal((len(q), 3)))
