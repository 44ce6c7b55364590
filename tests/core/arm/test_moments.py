"""Load moments against Pinocchio's recursive Newton-Euler: the load is minus the reaction."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_core.arm.chain import Chain
from kilter_core.arm.conversions import robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.documents.parts import resolved_document, robot_from_resolved
from kilter_core.arm.load_slopes import payload_sensitivity
from kilter_core.arm.load_wrenches import axial_loads, joint_loads
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Joint, Robot
from kilter_core.effects import make_effect
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.truth import UR10_ROWS, Arm, Body, Step, some_arm, ur10, with_bodies

KINDS = {
    "revolute": {},
    "prismatic": {"prismatic": True},
    "coupled": {"coupled": True},
    "both": {"prismatic": True, "coupled": True},
    "followers": {"prismatic": True, "coupled": True},  # with a body on every moving step
}
CASES = [pytest.param(kind, n, seed, id=f"{kind}-{n}-{seed}") for kind in KINDS for n, seed in ((3, 1), (6, 2), (7, 3))]
ROWS = 8


def arm_robot(kind: str, n: int, seed: int) -> tuple[Arm, Robot, np.random.Generator]:
    rng = np.random.default_rng(seed)
    arm = with_bodies(some_arm(rng, n, **KINDS[kind]), rng, kind == "followers")
    # Gravity is given in the robot's base frame, so the truth of the forces stands at the origin.
    return replace(arm, base=pin.SE3.Identity()), robot_from_document(arm.document()), rng


@pytest.mark.parametrize(("kind", "n", "seed"), CASES)
def test_static_loads_are_minus_the_reactions(kind: str, n: int, seed: int) -> None:
    arm, robot, rng = arm_robot(kind, n, seed)
    q = rng.uniform(-2.0, 2.0, (ROWS, n))
    loads = joint_loads(robot, q)
    axial = axial_loads(robot, loads)
    for k in range(ROWS):
        torques, wrenches, root = arm.reactions(q[k])
        np.testing.assert_allclose(axial[k], -torques, atol=1e-10, rtol=0)
        np.testing.assert_allclose(loads.joints[k], -wrenches, atol=1e-10, rtol=0)
        np.testing.assert_allclose(loads.base[k], -root, atol=1e-10, rtol=0)


@pytest.mark.parametrize(("kind", "n", "seed"), CASES)
def test_dynamic_loads_with_a_payload_are_minus_the_reactions(kind: str, n: int, seed: int) -> None:
    arm, robot, rng = arm_robot(kind, n, seed)
    q, qd, qdd = (rng.uniform(-2.0, 2.0, (ROWS, n)) for _ in range(3))
    kg, place = rng.uniform(0.5, 4.0, ROWS), rng.uniform(-0.1, 0.1, (ROWS, 3))
    loads = joint_loads(robot, q, qd=qd, qdd=qdd, payload_kg=kg, payload_com=place)
    axial = axial_loads(robot, loads)
    for k in range(ROWS):
        torques, wrenches, root = arm.reactions(q[k], qd[k], qdd[k], payload=(kg[k], place[k]))
        np.testing.assert_allclose(axial[k], -torques, atol=1e-10, rtol=0)
        np.testing.assert_allclose(loads.joints[k], -wrenches, atol=1e-10, rtol=0)
        np.testing.assert_allclose(loads.base[k], -root, atol=1e-10, rtol=0)


@pytest.mark.parametrize(("kind", "n", "seed"), CASES)
def test_a_wrench_on_the_tool_loads_the_joints(kind: str, n: int, seed: int) -> None:
    arm, robot, rng = arm_robot(kind, n, seed)
    q, external = rng.uniform(-2.0, 2.0, (ROWS, n)), rng.normal(0.0, 20.0, (ROWS, 6))
    loads = joint_loads(robot, q, external=external)
    axial = axial_loads(robot, loads)
    for k in range(ROWS):
        torques, wrenches, _ = arm.reactions(q[k], external=external[k])
        np.testing.assert_allclose(axial[k], -torques, atol=1e-10, rtol=0)
        np.testing.assert_allclose(loads.joints[k], -wrenches, atol=1e-10, rtol=0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(1, 8), kind=st.sampled_from(sorted(KINDS)))
def test_moments_of_any_arm_are_minus_pinocchio_s_rnea(seed: int, n: int, kind: str) -> None:
    arm, robot, rng = arm_robot(kind, n, seed)
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (2, n)) for _ in range(3))
    kg, external = rng.uniform(0.5, 4.0, 2), rng.normal(0.0, 20.0, (2, 6))
    loads = joint_loads(robot, q, qd=qd, qdd=qdd, payload_kg=kg, external=external)
    for k in range(2):
        torques, wrenches, _ = arm.reactions(q[k], qd[k], qdd[k], payload=(kg[k], np.zeros(3)), external=external[k])
        np.testing.assert_allclose(axial_loads(robot, loads)[k], -torques, atol=1e-10, rtol=1e-13)
        np.testing.assert_allclose(loads.joints[k], -wrenches, atol=1e-10, rtol=1e-13)


def test_the_tool_point_is_where_the_nominal_arm_has_it() -> None:
    arm, robot, rng = arm_robot("prismatic", 6, 4)
    q = rng.uniform(-2.0, 2.0, (ROWS, 6))
    np.testing.assert_allclose(joint_loads(robot, q).tool_point, arm.poses(q)[0], atol=1e-12, rtol=0)


def test_what_hangs_on_the_end_of_a_link_is_the_load_of_the_next_joint_turned_into_it() -> None:
    arm, robot, rng = arm_robot("revolute", 6, 5)
    q = rng.uniform(-2.0, 2.0, (1, 6))
    loads = joint_loads(robot, q)
    model, _ = arm.pinocchio()
    data = model.createData()
    pin.rnea(model, data, arm.motors(q[0]), np.zeros(6), np.zeros(6))
    for j in range(5):
        f = data.f[j + 2]
        turn = data.liMi[j + 2].rotation
        mine = robot.chain.program.joint_frame[j]
        expected = -np.concatenate([mine.T @ turn @ f.linear, mine.T @ turn @ f.angular])
        np.testing.assert_allclose(loads.ends[0, j], expected, atol=1e-10, rtol=0)


def test_links_of_a_table_of_rows_stand_in_their_row_s_frame() -> None:
    document = preset_document("ur10")
    bodies = []
    for j, link in enumerate(document["links"]):
        # The row's frame follows Tx(a) Rx(alpha) after the joint; carry the centre of mass back to the joint.
        _, a, alpha = UR10_ROWS[j]
        back = pin.SE3(pin.exp3(np.array([alpha, 0.0, 0.0])), np.array([a, 0.0, 0.0]))
        bodies.append(Body(j, link["mass_kg"], back.act(np.array(link["com_mm"]) * 1e-3)))
    arm, robot = ur10(bodies=tuple(bodies)), robot_from_document(document)
    q = np.random.default_rng(6).uniform(-3.0, 3.0, (ROWS, 6))
    axial = axial_loads(robot, joint_loads(robot, q))
    for k in range(ROWS):
        np.testing.assert_allclose(axial[k], -arm.reactions(q[k])[0], atol=1e-10, rtol=0)


def test_payload_sensitivity_is_the_difference_of_two_payloads() -> None:
    arm, robot, rng = arm_robot("revolute", 6, 7)
    q, place = rng.uniform(-2.0, 2.0, (ROWS, 6)), rng.uniform(-0.1, 0.1, (ROWS, 3))
    found = payload_sensitivity(robot, Observations(q, payload_kg=np.full(ROWS, 2.0), payload_com=place))
    for k in range(ROWS):
        bare = arm.reactions(q[k])[0]
        np.testing.assert_allclose(found[k, :, 0], bare - arm.reactions(q[k], payload=(1.0, place[k]))[0], atol=1e-10)
        for i, e in enumerate(np.eye(3)):
            here, there = (arm.reactions(q[k], payload=(1.0, p))[0] for p in (place[k], place[k] + e))
            np.testing.assert_allclose(found[k, :, 1 + i], here - there, atol=1e-10)


def horizontal_beam() -> Arm:
    """One joint about -y whose link lies along x: turning it up is positive."""
    steps = (Step("ry", 0.0, 0, -1.0, "joint"), Step("tx", 1.0, name="length"))
    return Arm(steps, 1, bodies=(Body(0, 2.0, np.array([0.5, 0.0, 0.0])),))


def test_a_horizontal_arm_droops() -> None:
    robot = robot_from_document(horizontal_beam().document())
    soft = Calibration.nominal(robot, (make_effect("axial_compliance"),))
    values = soft.values.copy()
    values[list(soft.names).index("compliance_1")] = 1e-4
    q = np.zeros((1, 1))
    load = axial_loads(robot, joint_loads(robot, q))[0, 0]
    assert load == pytest.approx(-2.0 * 9.80665 * 0.5, abs=1e-12)
    tip = soft.model.predict(Observations(q), values).position[0]
    assert tip[2] == pytest.approx(np.sin(1e-4 * load), abs=1e-15)
    assert tip[2] < 0.0


def test_a_katana_stretched_out_droops_at_every_bending_joint() -> None:
    robot = robot_from_document(preset_document("katana450-chapter5"))
    q = np.zeros((1, 5))
    loads = axial_loads(robot, joint_loads(robot, q))[0]
    # By hand: mass times horizontal distance of each centre, tables 4.1 and 4.2; links 4 and 5 stand at the wrist.
    links = ((1.03, 0.100), (0.9, 0.190 + 0.104), (1.0, 0.329), (0.8, 0.329))
    for joint, x, carried in ((1, 0.0, links), (2, 0.190, links[1:])):
        assert loads[joint] == pytest.approx(-9.80665 * sum(m * (at - x) for m, at in carried), abs=1e-12)


def opened(robot: Robot) -> Robot:
    """The same bodies on an arm whose every moving axis is a joint of its own."""
    elements, joints = list(robot.chain.elements), []
    for k in robot.chain.driven:
        elements[k] = replace(elements[k], joint=len(joints), ratio=1.0)
        joints.append(Joint(f"a{k}", "revolute" if elements[k].axis.rotates else "prismatic"))
    return replace(robot, joints=tuple(joints), chain=Chain(tuple(elements), len(joints)))


@pytest.mark.parametrize("dynamic", [False, True])
def test_bodies_of_mimic_joints_take_part_in_the_torque_of_their_leader(dynamic: bool) -> None:
    """What all axes of a joint feel, by the ratios, is what Pinocchio needs to move it: virtual work."""
    arm, robot, rng = arm_robot("followers", 5, 8)
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (ROWS, 5)) for _ in range(3))
    still = np.zeros(5)
    G = np.array([[step.ratio * (step.joint == j) for j in range(5)] for step in arm.moving])
    model, _ = arm.pinocchio()
    data = model.createData()
    free = opened(robot)
    motion = {"qd": qd @ G.T, "qdd": qdd @ G.T} if dynamic else {}
    axial = axial_loads(free, joint_loads(free, q @ G.T, **motion))
    for k in range(ROWS):
        rates = (qd[k], qdd[k]) if dynamic else (still, still)
        torque = G.T @ pin.rnea(model, data, arm.motors(q[k]), *(G @ rate for rate in rates))
        np.testing.assert_allclose(axial[k] @ G, -torque, atol=1e-9, rtol=0)


def test_robots_with_bodies_on_mimic_joints_are_stored_as_they_are() -> None:
    arm, robot, rng = arm_robot("followers", 5, 8)
    assert len(robot.links) == len(arm.moving) > 5
    stored = json.loads(json.dumps(resolved_document(robot)))
    again = robot_from_resolved(robot.name, stored)
    assert resolved_document(again) == stored
    q = rng.uniform(-1.0, 1.0, (3, 5))
    np.testing.assert_array_equal(joint_loads(again, q).joints, joint_loads(robot, q).joints)


@pytest.mark.parametrize("convention", ["chain", "poe"])
def test_bodies_of_mimic_joints_are_converted(convention: str) -> None:
    _, robot, rng = arm_robot("followers", 5, 8)
    again = robot_from_document(robot_document(robot, convention))
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (3, 5)) for _ in range(3))
    here, there = (axial_loads(r, joint_loads(r, q, qd=qd, qdd=qdd)) for r in (robot, again))
    np.testing.assert_allclose(there, here, atol=1e-9, rtol=0)


@pytest.mark.parametrize(
    ("on_axis", "said"), [(9, "moving axes 1 to 3"), (1, "that of a joint itself"), (3, "that of a joint itself")]
)
def test_a_body_hangs_on_an_axis_that_is_there_and_no_joint_s_own(on_axis: int, said: str) -> None:
    steps = (Step("rz", 0.0, 0), Step("tx", 0.5), Step("ry", 0.0, 0, -0.5), Step("tx", 0.5), Step("ry", 0.0, 1))
    document = Arm(steps, 2).document()
    body = {"mass_kg": 2.0, "com_mm": [100.0, 0.0, 0.0]}
    alone = robot_from_document({**document, "links": [{**body, "on_axis": 2}]})
    assert [(link.element, link.mass) for link in alone.links] == [(0, 0.0), (4, 0.0), (2, 2.0)]
    with pytest.raises(RobotError, match=said):
        robot_from_document({**document, "links": [{**body, "on_axis": on_axis}]})
    with pytest.raises(RobotError, match="1 links for 2 joints"):
        robot_from_document({**document, "links": [body, {**body, "on_axis": 2}]})
