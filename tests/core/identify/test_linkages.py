"""Stiffness of gear 2 of a palletiser: found where the document says that a linkage loads it, missed where it does not."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.palletiser import palletiser, said
from tests.core.truth import Arm

SOFT = {2: 4e-6, 3: 6e-6}  # rad/(N m) by joint, from 1
NOISE_M = 2e-5


def loads(arm: Arm, q: np.ndarray, linked: bool) -> np.ndarray:
    """Loads (N, n) on the motors by virtual work over the axes of Pinocchio; without a linkage those of their own axes."""
    model, _ = arm.pinocchio()
    out = np.zeros(q.shape)
    for row, here in enumerate(q):
        tau = pin.computeGeneralizedGravity(model, model.createData(), arm.motors(here))
        for m, step in enumerate(arm.moving):
            own = m == arm.first_of(step.joint)
            out[row, step.joint] -= (step.ratio if linked else np.sign(step.ratio) * own) * tau[m]
    return out


def measured(linked: bool, seed: int = 0) -> Observations:
    arm, rng = palletiser(), np.random.default_rng(seed)
    q = rng.uniform(-1.1, 1.1, (60, arm.n))
    bent, load = q.copy(), loads(arm, q, linked)
    for joint, c in SOFT.items():
        bent[:, joint - 1] += c * load[:, joint - 1]
    return Observations(q, position=arm.poses(bent)[0] + rng.normal(0.0, NOISE_M, (60, 3)))


@pytest.mark.parametrize("drive", ["linkage", "controller", "series"])
def test_compliance_of_the_gears_of_a_palletiser_is_found(drive: str) -> None:
    rows = measured(drive == "linkage")
    options = IdentifyOptions(effects=({"id": "axial_compliance", "joints": list(SOFT)},), masses="as_stated")
    found = identify(robot_from_document(said(palletiser(), drive)), rows, None, options)
    other = "controller" if drive == "linkage" else "linkage"
    missed = identify(robot_from_document(said(palletiser(), other)), rows, None, options)
    values, wrong = (dict(zip(f.calibration.names, f.calibration.values, strict=True)) for f in (found, missed))
    sigma = dict(zip(found.fit.names, found.fit.sigma, strict=True))
    for joint, c in SOFT.items():
        assert abs(values[f"compliance_{joint}"] - c) < 3.5 * sigma[f"compliance_{joint}"]
    assert sigma["compliance_2"] < 0.1 * SOFT[2]
    assert abs(wrong["compliance_2"] - SOFT[2]) > 4.0 * sigma["compliance_2"]
