"""What an arm carries: mass, centre and inertia of bodies that Pinocchio's dynamics carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.motion import weigh_payload
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Logger, reversed_softly, seven_like, ur_like
from tests.core.truth import Arm, Body, Floats

TOOL = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.4])), np.array([0.01, -0.02, 0.09]))


def rows(logger: Logger) -> Observations:
    log = logger.log()
    return Observations(q=log["q"], t=log["t"], tau=log["tau"])


def carried(arm: Arm, mass: float, centre: Floats, inertia: Floats) -> Arm:
    """The arm with a body, ``centre`` and ``inertia`` about it in the tool frame."""
    last = max(k for k, step in enumerate(arm.steps) if step.joint is not None)
    pose = pin.SE3.Identity()
    for step in arm.steps[last + 1 :]:
        pose = pose * step.motion()
    pose = pose * arm.tool
    R = pose.rotation
    body = Body(arm.n - 1, mass, pose.act(centre), R @ inertia @ R.T)
    return replace(arm, bodies=(*arm.bodies, body))


@pytest.mark.parametrize(("build", "seed"), [(ur_like, 1), (seven_like, 2)])
def test_mass_and_centre_are_right_and_their_intervals_hold(build: type, seed: int) -> None:
    arm = replace(build(np.random.default_rng(seed)), tool=TOOL)
    mass, centre, inertia = 2.4, np.array([0.03, -0.02, 0.06]), np.diag([0.012, 0.010, 0.006])
    load = carried(arm, mass, centre, inertia)
    friction = [lambda s: 0.06 * reversed_softly(s.qd, 0.004) * np.abs(s.rigid)]
    empty, loaded = (Logger(one, seed=seed, extra=list(friction)) for one in (arm, load))
    loaded.rng = np.random.default_rng(seed + 100)  # other motions, on the same friction
    found = weigh_payload(robot_from_document(arm.document()), [rows(loaded)], [rows(empty)])
    assert abs(found.mass - mass) < 0.02 * mass
    assert np.linalg.norm(found.centre - centre) < 0.005
    assert abs(found.mass - mass) < 4.0 * found.mass_sigma
    assert np.all(np.abs(found.centre - centre) < 4.0 * found.centre_sigma)
    assert np.all(np.abs(found.inertia - inertia) < 5.0 * found.inertia_sigma)
    assert np.all(found.left[1][:4] < 0.5 * found.left[0][:4])


def test_nothing_carried_weighs_nothing_and_has_no_centre() -> None:
    arm = ur_like(np.random.default_rng(3))
    first, second = Logger(arm, seed=3), Logger(arm, seed=3)
    second.rng = np.random.default_rng(33)
    found = weigh_payload(robot_from_document(arm.document()), [rows(second)], [rows(first)])
    assert abs(found.mass) < 4.0 * found.mass_sigma < 0.2
    assert np.isnan(found.centre).all()


def test_a_log_at_rest_weighs_nothing() -> None:
    arm = ur_like(np.random.default_rng(4))
    moving = rows(Logger(arm, seed=4, motions=2))
    rest = replace(moving, q=np.zeros_like(moving.q))
    with pytest.raises(ObservationError) as refused:
        weigh_payload(robot_from_document(arm.document()), [rest], [moving])
    assert refused.value.code == "log_at_rest"
