"""Slow motions of base and instrument behind everything else: what makes repeats drift."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm
from tests.blind.generator.causes import column_bending, random_walk, settling, twist
from tests.blind.generator.physics import REFERENCE_C, Physics, drift
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]

KINDS = ("linear", "settling", "walk", "column", "thermal")
IDS = {"linear": "drift", "settling": "settling", "walk": "random_walk", "column": "column_bending"}
LARGEST_M = 1.5e-3


def background_of(kind: str, arm: Arm, visits: Visits, rng: np.random.Generator) -> Physics:
    """The motion of one kind. "thermal" moves and turns the foot with the temperature; no library lists it."""
    if kind == "linear":
        return drift(arm, visits, ())
    if kind == "settling":
        return settling(arm, visits, (), rng.uniform(0.1, 0.5))
    if kind == "walk":
        return random_walk(arm, visits, (), rng)
    if kind == "column":
        return column_bending(arm, visits, ())
    return twist(arm, visits.temperature_c - REFERENCE_C)


def scaled_to(moved: Floats, visits: Visits, variance: float, overstated: float) -> float:
    """Factor on displacements (V, 3) with which repeats pooled over the campaign scatter ``overstated`` times too much.

    ``variance`` m2 is what a repeat scatters by rights, over three coordinates. Without repeats the whole spread counts.
    """
    size = pooled(moved, visits)
    if size == 0.0:
        size = float(np.sum(np.var(moved, axis=0)))
    farthest = float(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max())
    wanted = np.sqrt(max(overstated**2 - 1.0, 0.0) * variance / max(size, 1e-30))
    return float(min(wanted, LARGEST_M / max(farthest, 1e-30)))


def pooled(moved: Floats, visits: Visits) -> float:
    """Variance (m2, over three coordinates) that repeats of one condition have, pooled whatever lies between them."""
    condition = np.column_stack([visits.pose, visits.direction, visits.payload_kg, visits.session])
    group = np.unique(condition, axis=0, return_inverse=True)[1].reshape(-1)
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, c) for c in moved.T], axis=1) / count[:, None]
    freedom = int(np.sum(count - 1))
    return float(np.sum((moved - mean[group]) ** 2) / freedom) if freedom else 0.0
