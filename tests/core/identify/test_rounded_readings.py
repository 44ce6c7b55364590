"""Joint readings in whole steps: intervals of an identification hold, for its covariance follows what poses leave."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.identify.test_zero_offsets import LENGTH_M, ZERO_DEG, document, points

ARMS, NOISE_M = 25, 2e-5


@pytest.mark.parametrize(
    ("step_deg", "poses", "visits"),
    [pytest.param(360.0 / 4096.0, 40, 1, marks=pytest.mark.slow), (360.0 / 4096.0, 15, 3), (0.01, 40, 1)],
)
def test_intervals_hold_with_readings_in_whole_steps(step_deg: float, poses: int, visits: int) -> None:
    """100 intervals of 95 %; visits of one pose share the error of their reading and are no three of them."""
    robot = robot_from_document(document())
    nominal = Calibration.nominal(robot)
    inside = []
    for seed in range(ARMS):
        rng = np.random.default_rng(seed)
        zeros, lengths = np.radians(rng.normal(0.0, ZERO_DEG, 5)), rng.normal(0.0, LENGTH_M, (5, 2))
        lengths[1:3, 0] = 0.0
        q = np.repeat(rng.uniform(-1.4, 1.4, (poses, 5)), visits, axis=0)
        seen = points(q, zeros, lengths) + rng.normal(0.0, NOISE_M, (len(q), 3))
        read = np.radians(np.round(np.degrees(q) / step_deg) * step_deg)
        found = identify(robot, Observations(read, position=seen), options=IdentifyOptions(level=2))
        off = dict(zip(found.calibration.names, found.calibration.values - nominal.values, strict=True))
        sigma = dict(zip(found.fit.names, found.fit.sigma, strict=True))
        truth = {"theta_offset_2": zeros[1], "theta_offset_3": zeros[2], "a_2": lengths[1, 1], "a_3": lengths[2, 1]}
        inside += [abs(off[name] - true) <= 1.96 * sigma[name] for name, true in truth.items()]
    assert 0.89 <= np.mean(inside) <= 0.99, np.mean(inside)
