"""Stiffness of an arm whose mimic joint carries a body: found with its mass, missed without. Pinocchio measures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.truth import Arm, Body, Step, ur10

SOFT = {2: 2e-5, 3: 3e-5}  # rad/(N m) by joint, from 1
NOISE_M = 2e-5


def lifting() -> Arm:
    """A UR10 whose third axis follows the second (a parallelogram), with a heavy body between the two third axes."""
    arm = ur10()
    at = next(k for k, step in enumerate(arm.steps) if step.joint == 2)
    steps = (*arm.steps[:at], Step("rz", 0.0, 1, -0.6, "follower"), *arm.steps[at:])
    links = [Body(j, 3.0, np.array([-0.2, 0.02, 0.05])) for j in range(6)]
    return replace(arm, steps=steps, bodies=(*links, Body(1, 25.0, np.array([0.3, -0.25, 0.1]), moving=2)))


def test_the_mass_behind_a_mimic_joint_counts_in_an_identification() -> None:
    arm, rng = lifting(), np.random.default_rng(0)
    q = np.array([0.0, -1.2, 1.4, -0.6, 0.9, 0.2]) + rng.uniform(-1.0, 1.0, (60, 6))
    load = -np.array([arm.reactions(row)[0] for row in q])
    bent = q.copy()
    for joint, c in SOFT.items():
        bent[:, joint - 1] += c * load[:, joint - 1]
    rows = Observations(q, position=arm.poses(bent)[0] + rng.normal(0.0, NOISE_M, (60, 3)))
    options = IdentifyOptions(effects=({"id": "axial_compliance", "joints": list(SOFT)},), masses="as_stated")
    found, without = (
        identify(robot_from_document(own.document()), rows, None, options)
        for own in (arm, replace(arm, bodies=arm.bodies[:6], base=pin.SE3.Identity()))
    )
    at = dict(zip(found.calibration.names, found.calibration.values, strict=True))
    sigma = dict(zip(found.fit.names, found.fit.sigma, strict=True))
    missed = dict(zip(without.calibration.names, without.calibration.values, strict=True))
    for joint, c in SOFT.items():
        name = f"compliance_{joint}"
        assert abs(at[name] - c) < 3.5 * sigma[name]
        assert sigma[name] < 0.1 * c
        assert abs(missed[name] - c) > 10.0 * sigma[name]
