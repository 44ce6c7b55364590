"""How far a type moves an arm: by no more than a share of the error that its rows leave, by derivatives of another model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fleet_linear import FRAMES, NOISE, SPREAD, WIDE, Prior, Station, derivatives
from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.fleet_prior import FleetVersion
from kilter_core.identify.fleet_report import MOST
from kilter_core.observations import Observations
from tests.core.identify.fleet.simulated import Arm, Type, document, poses

PLAIN, FLEET = IdentifyOptions(noise_mm=0.05), IdentifyOptions(noise_mm=0.05, prior="fleet")


@pytest.fixture(scope="module")
def fleet() -> tuple[Type, list[FleetVersion]]:
    rng = np.random.default_rng(30)
    kind, robot, out = Type.drawn(rng), robot_from_document(document()), []
    for k in range(7):
        found = identify(robot, kind.arm(rng).measured(poses(50, rng), rng, NOISE))
        out.append(
            FleetVersion.from_calibration(f"r{k}", f"ver_{k}", found.calibration, found.predictive.to_document())
        )
    return kind, out


def expected_rms_m(q: np.ndarray, unseen: np.ndarray) -> float:
    """What is expected of a fit without a type at unseen poses, rms of the length (m)."""
    station = Station(derivatives(q) / NOISE, derivatives(unseen), derivatives(unseen))
    alone = Prior(np.zeros(len(SPREAD)), WIDE**2 * np.eye(len(SPREAD)))
    covariance = station.fitted(np.zeros((3 * len(q), 1)), alone)[1]
    assert len(covariance) == len(SPREAD) + FRAMES
    return float(np.sqrt(np.einsum("ij,jk,ik->", station.unseen, covariance, station.unseen) / len(unseen)))


def moved_m(
    arm: Arm, q: np.ndarray, unseen: np.ndarray, versions: list[FleetVersion], seed: int
) -> tuple[float, float]:
    """How far the type moves the tool (m, rms), and by how much it was taken wider for that."""
    rows, robot = arm.measured(q, np.random.default_rng(seed), NOISE), robot_from_document(document())
    without, with_type = (identify(robot, rows, options=one, fleet=versions) for one in (PLAIN, FLEET))
    places = [one.calibration.predict(Observations(unseen)).position for one in (without, with_type)]
    use = with_type.fit.prior_use
    assert use is not None
    told = with_type.to_document()["prior"]
    assert told["limited_by"] == use.limited_by
    assert (f"may move the tool by {MOST:g} of the error" in told["sentence"]) == (use.limited_by > 1.0)
    return float(np.sqrt(np.mean(np.sum((places[1] - places[0]) ** 2, axis=1)))), use.limited_by


def test_an_arm_is_moved_by_no_more_than_its_rows_allow(fleet: tuple[Type, list[FleetVersion]]) -> None:
    kind, versions = fleet
    wider = []
    for count, seed in ((12, 1), (12, 4), (14, 1), (14, 2)):
        rng = np.random.default_rng(seed)
        arm = replace(kind.arm(rng), base=np.eye(4))
        arm.errors[1 + seed % 4, 0] += 6.0 * kind.angle
        q, unseen = poses(count, rng), poses(300, rng)
        by, limited_by = moved_m(arm, q, unseen, versions, seed)
        assert by <= 1.15 * MOST * expected_rms_m(q, unseen), (
            count,
            seed,
            by,
        )  # at other poses than those it was limited at
        wider.append(limited_by > 1.0)
    assert sum(wider) >= 1
