"""Campaigns measured on the independent arms of :mod:`tests.core.truth`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_core.observations import Observations
from tests.core.truth import Arm

Floats = NDArray[np.float64]
MARKERS = np.array([[0.04, 0.0, 0.01], [-0.02, 0.03, 0.0], [-0.02, -0.03, 0.02]])


def joints(arm: Arm, count: int, rng: np.random.Generator) -> Floats:
    """Joint vectors within the arm's limits."""
    return rng.uniform(*arm.limits, (count, arm.n))


def measured(
    arm: Arm, q: Floats, rng: np.random.Generator, noise_m: float = 0.0, see: str = "position", **columns: Any
) -> Observations:
    """What an instrument sees of the arm: its tool "position", "pose" (with 1 rad of noise per metre) or "markers"."""
    position, rotation = arm.poses(q)
    if see == "markers":
        points = position[:, None] + np.einsum("nij,mj->nmi", rotation, MARKERS)
        return Observations(q, markers=points + rng.normal(0.0, noise_m, points.shape), **columns)
    seen = position + rng.normal(0.0, noise_m, position.shape)
    if see == "position":
        return Observations(q, position=seen, **columns)
    turned = Rotation.from_rotvec(rng.normal(0.0, noise_m, (len(q), 3))).as_matrix() @ rotation
    return Observations(q, position=seen, rotation=turned, **columns)


def table_errors(arm: Arm, rng: np.random.Generator, metres: float = 5e-4, radians: float = 1e-3) -> dict[str, float]:
    """A random error for every named step."""
    return {s.name: float(rng.normal(0.0, radians if s.axis[0] == "r" else metres)) for s in arm.steps if s.name}


def held(arm: Arm, q: Floats, towards: Any) -> Floats:
    """Joint vectors near ``q`` of an uncoupled arm at which ``towards(position) -> (residual (k,), slope (k, 3))`` is zero."""
    model, frame = arm.pinocchio()
    data, out = model.createData(), []
    for row in q:
        here = row.copy()
        for _ in range(60):
            J = pin.computeFrameJacobian(model, data, arm.motors(here), frame, pin.LOCAL_WORLD_ALIGNED)
            r, D = towards(pin.updateFramePlacement(model, data, frame).translation)
            if np.abs(r).max() < 1e-11:
                out.append(here)
                break
            slope = D @ J[:3]
            step = -slope.T @ np.linalg.solve(slope @ slope.T + 1e-9 * np.eye(len(r)), r)
            here = here + step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
    return np.array(out)
