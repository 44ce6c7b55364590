"""Pose sets that are too alike are told from good ones, by what they predict elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.report import workspace_uncertainty
from kilter_core.observations import Observations
from tests.core.campaigns import measured, table_errors
from tests.core.truth import ur10

NOISE = 2e-5


def fitted(width: float, rows: int = 60) -> tuple[object, NDArray[np.float64]]:
    """An identification from poses within ``width`` rad, and the true error of its predictions over the limits."""
    rng = np.random.default_rng(0)
    arm = ur10()
    actual = arm.moved(table_errors(arm, rng))
    q = 0.4 + rng.uniform(-width, width, (rows, 6))
    found = identify(robot_from_document(arm.document()), measured(actual, q, rng, NOISE))
    elsewhere = rng.uniform(*arm.limits, (200, 6))
    return found, found.calibration.predict(Observations(elsewhere)).position - actual.poses(elsewhere)[0]


@pytest.mark.parametrize(("width", "warned"), [(2.0, False), (1.0, False), (0.2, True), (0.05, True)])
def test_poses_that_are_too_alike_are_said_to_be(width: float, warned: bool) -> None:
    found, error = fitted(width)
    said = {w["code"]: w for w in found.warnings}
    assert ("poses_ill_conditioned" in said) == warned
    spread = workspace_uncertainty(found.fit)
    # The prediction of the uncertainty is of the size of the error there is.
    true = float(np.sqrt(np.mean(error**2)))
    assert true / 4 < spread.elsewhere < 8 * true
    if warned:
        assert "kilter plan" in said["poses_ill_conditioned"]["message"]
        assert true > 5 * NOISE


def test_a_held_chain_and_distances_have_no_spread() -> None:
    rng = np.random.default_rng(0)
    arm = ur10()
    robot, rows = robot_from_document(arm.document()), measured(arm, rng.uniform(-2, 2, (40, 6)), rng, NOISE)
    assert (
        workspace_uncertainty(identify(robot, rows, None, IdentifyOptions(free=("base_*",), tool="fixed")).fit) is None
    )
    assert workspace_uncertainty(identify(robot, rows, None, IdentifyOptions(base="removed")).fit) is None
