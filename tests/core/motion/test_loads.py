"""What torques say of masses, and what a fit and a search in poses make of it: Pinocchio moves the arm, and bends it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_slopes import with_masses
from kilter_core.arm.robot import Robot
from kilter_core.errors import OptionError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.motion import find_missing_torque, told_loads
from kilter_core.motion.regressor import rigid_regressor, stated_numbers
from kilter_core.observations import Observations
from kilter_service.jobs.setups import to_json_types
from tests.core.identify.test_carried_masses import ASKED, SOFT, measured, standing
from tests.core.motion.moving_arm import Logger
from tests.core.truth import Arm

SEEDS = range(4)


def solid() -> Arm:
    """The arm of the poses, with bodies that have a size."""
    arm = standing()
    bodies = tuple(
        replace(b, inertia=pin.Inertia.FromBox(b.mass, 0.12, 0.1, 0.1).inertia, com=np.array(b.com, dtype=float))
        for b in arm.bodies
    )
    return replace(arm, bodies=bodies)


def described(seed: int) -> Robot:
    """The robot as its user describes it: every mass a fifth off, every centre 10 mm."""
    rng = np.random.default_rng(300 + seed)
    robot = robot_from_document(solid().document())
    links = tuple(
        replace(link, mass=link.mass * (1.0 + 0.2 * rng.choice([-1.0, 1.0])), com=link.com + rng.normal(0.0, 0.01, 3))
        for link in robot.links
    )
    return replace(robot, links=links)


@pytest.fixture(scope="module")
def told() -> list[Robot]:
    """The described robots with what a log of the true arm says."""
    log = Logger(solid(), seed=11).log()
    rows = Observations(q=log["q"], t=log["t"], tau=log["tau"])
    out = []
    for seed in SEEDS:
        robot = described(seed)
        model = find_missing_torque(robot, rows).model.to_document()
        out.append(replace(robot, told_loads=told_loads(robot, json.loads(json.dumps(to_json_types(model["loads"]))))))
    return out


def held(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Torques (N, n) that hold a robot still, as described and as told."""
    told = robot.told_loads
    still = np.zeros_like(q)
    one = robot if told is None else with_masses(robot, told.mean.tolist())
    return rigid_regressor(one, q, still, still) @ stated_numbers(one)


def test_told_masses_hold_the_arm_as_the_true_ones_do(told: list[Robot]) -> None:
    q = np.random.default_rng(1).uniform(-1.2, 1.2, (50, 6))
    right = solid().torques(q)
    for robot in told:
        before, after = (held(one, q) - right for one in (replace(robot, told_loads=None), robot))
        rms = [np.sqrt(np.mean(one**2, axis=0)) for one in (before, after)]
        assert np.all(rms[1][1:] < 0.01 * right.std(axis=0)[1:] + 0.01)
        assert np.all(rms[1][1:3] < 0.1 * rms[0][1:3])


def fitted(robot: Robot, seed: int) -> Identification:
    return identify(robot, measured(standing(), seed), None, IdentifyOptions(effects=(ASKED,)))


def test_compliances_follow_the_told_masses(told: list[Robot]) -> None:
    """Twenty compliances by masses a fifth wrong: nearer with torques told, and within their intervals, which are narrower."""
    wrong: dict[str, list[float]] = {"untold": [], "told": []}
    inside = 0
    for seed, robot in zip(SEEDS, told, strict=True):
        for name, one in (("untold", replace(robot, told_loads=None)), ("told", robot)):
            found = fitted(one, seed)
            at = dict(zip(found.calibration.names, found.calibration.values, strict=True))
            sigma = dict(zip(found.fit.names, found.fit.sigma, strict=True))
            wrong[name] += [abs(at[f"compliance_{j}"] / c - 1.0) for j, c in SOFT.items()]
            if name == "told":
                inside += sum(abs(at[f"compliance_{j}"] - c) < 1.96 * sigma[f"compliance_{j}"] for j, c in SOFT.items())
    assert inside >= len(wrong["told"]) - 1
    assert np.median(wrong["told"]) < 0.025
    assert np.median(wrong["told"]) < 0.3 * np.median(wrong["untold"])


def test_a_search_names_the_same_and_keeps_the_told_masses(told: list[Robot]) -> None:
    rows = measured(standing(), 5)
    found = find_gap(told[0], rows, GapOptions(next_poses=0, permutations=5, resamples=20, bootstraps=199))
    named = {(e["id"], *e["joints"]) for e in found.to_document()["effects"]}
    assert {("axial_compliance", 2), ("axial_compliance", 3)} <= named
    values = dict(zip(found.stored.calibration.names, found.stored.calibration.values, strict=True))
    assert values["compliance_2"] == pytest.approx(SOFT[2], rel=0.03)
    assert values["link_mass_2"] != 0.0


def test_masses_that_were_changed_since_the_search_are_refused(told: list[Robot]) -> None:
    robot = told[0]
    document = to_json_types(find_missing_torque_loads(robot))
    with pytest.raises(OptionError, match="described otherwise"):
        told_loads(replace(robot, links=(*robot.links[:-1], replace(robot.links[-1], mass=1.0))), document)
    with pytest.raises(OptionError, match="without any"):
        told_loads(robot, None)


def find_missing_torque_loads(robot: Robot) -> dict:
    log = Logger(solid(), seed=12, motions=3).log()
    rows = Observations(q=log["q"], t=log["t"], tau=log["tau"])
    return find_missing_torque(robot, rows).model.to_document()["loads"]
