"""The torques of motions to come, by what a log showed, against Pinocchio's; links that could be real."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.motion import TorqueModel, find_missing_torque, path_of_rows
from kilter_core.motion.regressor import rigid_regressor, stated_numbers
from kilter_core.observations import Observations
from kilter_service.jobs.setups import to_json_types
from tests.core.motion.moving_arm import Logger, reversed_softly, seven_like, ur_like


def without_links(document: dict) -> dict:
    return {**document, "links": []}


@pytest.mark.parametrize(("build", "seed", "stated"), [(ur_like, 3, True), (seven_like, 4, False)])
def test_torques_of_motions_to_come(build: type, seed: int, stated: bool) -> None:
    arm = build(np.random.default_rng(seed))
    logger = Logger(arm, seed=seed, extra=[lambda s: 0.06 * reversed_softly(s.qd, 0.004) * np.abs(s.rigid)])
    log = logger.log()
    robot = robot_from_document(arm.document() if stated else without_links(arm.document()))
    report = find_missing_torque(robot, Observations(q=log["q"], t=log["t"], tau=log["tau"]))
    written = json.loads(json.dumps(to_json_types(report.model.to_document())))
    model = TorqueModel.from_document(robot, written)

    t = np.arange(0.0, 8.0, 0.01)
    q, qd, qdd = logger._path(t)  # a motion that the log does not have
    rigid = logger._rigid(q, qd, qdd)
    friction = logger.friction.coulomb * reversed_softly(qd, 0.004) + logger.friction.viscous * qd
    right = rigid + friction + 0.06 * reversed_softly(qd, 0.004) * np.abs(rigid)
    told = model.torques(path_of_rows(Observations(q=q, t=t)))
    wrong = np.sqrt(np.mean((told - right) ** 2, axis=0))
    assert np.all(wrong < 0.05 * logger.usual[: arm.n])
    assert np.all(wrong < 0.25 * right.std(axis=0) + 0.02 * logger.usual[: arm.n])


def test_links_that_could_be_real_hold_the_arm_as_the_true_ones_do() -> None:
    rng = np.random.default_rng(6)
    bodies = tuple(  # boxes: whatever else is random, a body of a third less than no thickness is none
        replace(body, inertia=pin.Inertia.FromBox(body.mass, *rng.uniform(0.05, 0.3, 3)).inertia)
        for body in seven_like(rng).bodies
    )
    arm = replace(seven_like(rng), bodies=bodies)
    log = Logger(arm, seed=6).log()
    document = arm.document()
    for link in document["links"]:  # masses a third wrong: the log says what they are
        link["mass_kg"] *= 1.33
    stated = robot_from_document(document)
    model = find_missing_torque(stated, Observations(q=log["q"], t=log["t"], tau=log["tau"])).model
    for link in model.links:
        moments = np.linalg.eigvalsh(link.inertia)
        assert link.mass > 0.0
        assert 0.0 < moments[2] < moments[0] + moments[1]
    q = rng.uniform(-1.0, 1.0, (40, 7))
    right = arm.torques(q)
    still = np.zeros_like(q)
    held = [
        rigid_regressor(one, q, still, still) @ stated_numbers(one)
        for one in (stated, replace(stated, links=model.links))
    ]
    wrong = [np.sqrt(np.mean((one - right) ** 2, axis=0)) for one in held]
    assert np.all(wrong[1][1:] < 0.02 * right.std(axis=0)[1:] + 0.01)
    assert np.all(wrong[1][1:4] < 0.1 * wrong[0][1:4])


def test_a_payload_on_a_path_is_carried() -> None:
    arm = ur_like(np.random.default_rng(5))
    log = Logger(arm, seed=5, motions=4).log()
    robot = robot_from_document(arm.document())
    model = find_missing_torque(robot, Observations(q=log["q"], t=log["t"], tau=log["tau"])).model
    t = np.arange(0.0, 1.0, 0.01)
    still = np.tile([0.0, -0.4, 0.5, 0.2, 0.3, 0.0], (len(t), 1))
    rows = Observations(q=still, t=t)
    empty, loaded = (model.torques(path_of_rows(one)) for one in (rows, rows.carrying(3.0, (0.0, 0.0, 0.1))))
    load = (3.0, np.array([0.0, 0.0, 0.1]))
    assert (loaded - empty)[0] == pytest.approx((arm.torques(still[:1], load) - arm.torques(still[:1]))[0], abs=1e-6)


def test_a_path_that_goes_back_in_time_is_refused() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.2, 0.3, 0.4, 0.5])
    with pytest.raises(ObservationError, match="Row 4"):
        path_of_rows(Observations(q=np.zeros((7, 2)), t=t))
    with pytest.raises(ObservationError, match="3 rows"):
        path_of_rows(Observations(q=np.zeros((3, 2)), t=t[:3]))
    with pytest.raises(ObservationError, match="t_s"):
        path_of_rows(Observations(q=np.zeros((7, 2))))
