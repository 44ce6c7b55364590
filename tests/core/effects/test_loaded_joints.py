"""Effects of the load on joints and base: droop by hand, and random arms bent by hand in Pinocchio."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.effects import Effect
from kilter_core.observations import Observations
from tests.core.effects.by_hand import G, effect_on, inserted, one_joint, tool_with
from tests.core.truth import Arm, some_arm, with_bodies

AT_ZERO = Observations(np.zeros((1, 1)))
COMPLIANCE = 1e-4


def test_a_horizontal_arm_droops_by_its_axial_compliance() -> None:
    arm = one_joint("ry", mass=2.0)
    tool = tool_with(arm, effect_on(arm, "axial_compliance"), {"compliance_1": COMPLIANCE}, AT_ZERO)
    angle = COMPLIANCE * 2.0 * G * 1.0
    np.testing.assert_allclose(tool.position[0], [math.cos(angle), 0.0, -math.sin(angle)], atol=1e-15)


def test_a_vertical_joint_leans_by_its_radial_compliance() -> None:
    arm = one_joint("rz", mass=2.0)
    rows = Observations(np.array([[0.7]]), payload_kg=np.array([1.0]))
    tool = tool_with(arm, effect_on(arm, "radial_compliance"), {"radial_compliance_1": COMPLIANCE}, rows)
    angle = COMPLIANCE * 3.0 * G
    reach = math.cos(angle)
    expected = [reach * math.cos(0.7), reach * math.sin(0.7), -math.sin(angle)]
    np.testing.assert_allclose(tool.position[0], expected, atol=1e-15)


def test_a_slide_gives_way_along_its_axis() -> None:
    arm = one_joint("tz", mass=2.0)
    tool = tool_with(arm, effect_on(arm, "axial_compliance"), {"compliance_1": 1e-5}, AT_ZERO)
    np.testing.assert_allclose(tool.position[0], [1.0, 0.0, -2.0 * G * 1e-5], atol=1e-15)


def test_a_joint_leans_by_its_clearance_towards_the_load_and_no_further() -> None:
    clearance = 1e-3
    for mass in (0.5, 50.0):
        arm = one_joint("rz", mass=mass)
        tool = tool_with(arm, effect_on(arm, "clearance_tilt"), {"clearance_1": clearance}, AT_ZERO)
        # Eq. 5.18 gives sin C as the tilt, which is C to a part in a million.
        assert tool.position[0, 2] == pytest.approx(-math.sin(math.sin(clearance)), abs=1e-12)


def test_load_sided_backlash_lets_the_arm_hang_on_either_side() -> None:
    arm = one_joint("ry", mass=2.0)
    rows = Observations(np.array([[0.0], [math.pi], [math.pi / 2]]))
    tool = tool_with(arm, effect_on(arm, "backlash_load"), {"backlash_load_1": 1e-3}, rows)
    np.testing.assert_allclose(tool.position[:2, 2], -math.sin(1e-3), atol=1e-12)
    np.testing.assert_allclose(tool.position[2], [0.0, 0.0, -1.0], atol=1e-12)  # hanging straight down it stays


def test_the_base_tips_towards_the_arm() -> None:
    arm = one_joint("rz", mass=2.0)
    rows = Observations(np.array([[0.0], [math.pi / 2]]))
    effect = effect_on(arm, "base_compliance")
    tool = tool_with(arm, effect, {"base_compliance_y": COMPLIANCE, "base_compliance_x": 2 * COMPLIANCE}, rows)
    np.testing.assert_allclose(tool.position[:, 2], [-math.sin(k * COMPLIANCE * 2.0 * G) for k in (1, 2)], atol=1e-14)


def random_arm(seed: int, *, prismatic: bool) -> tuple[Arm, Observations]:
    rng = np.random.default_rng(seed)
    arm = replace(with_bodies(some_arm(rng, 5, prismatic=prismatic), rng), base=pin.SE3.Identity())
    rows = Observations(
        rng.uniform(-2.0, 2.0, (4, 5)), qd=rng.normal(0.0, 1.0, (4, 5)), qdd=rng.normal(0.0, 3.0, (4, 5)),
        payload_kg=np.array([0.0, 1.0, 2.0, 4.0]), payload_com=rng.uniform(-0.1, 0.1, (4, 3)),
    )  # fmt: skip
    return arm, rows


def loads(arm: Arm, rows: Observations, k: int, kg: float | None = None, place: object = None) -> tuple[object, ...]:
    """Loads of one row from Pinocchio: minus the reactions."""
    assert rows.qd is not None
    assert rows.qdd is not None
    assert rows.payload_kg is not None
    assert rows.payload_com is not None
    carried = (rows.payload_kg[k] if kg is None else kg, rows.payload_com[k] if place is None else place)
    torques, wrenches, root = arm.reactions(rows.q[k], rows.qd[k], rows.qdd[k], payload=carried)
    return -torques, -wrenches, -root


@pytest.mark.parametrize("prismatic", [False, True])
def test_moving_arms_of_any_build_give_way_as_their_loads_say(prismatic: bool) -> None:
    arm, rows = random_arm(3, prismatic=prismatic)
    axial: Effect = effect_on(arm, "axial_compliance")
    radial, base = effect_on(arm, "radial_compliance"), effect_on(arm, "base_compliance")
    c = [1e-5, 2e-5, 3e-5, 4e-5, 5e-5]
    by_axial = tool_with(arm, axial, {f"compliance_{j + 1}": c[j] for j in range(5)}, rows)
    by_radial = tool_with(arm, radial, {f"radial_compliance_{j + 1}": c[j] for j in range(5)}, rows)
    by_base = tool_with(arm, base, {"base_compliance_x": 1e-5, "base_compliance_y": 2e-5}, rows)
    for k in range(len(rows)):
        torques, wrenches, root = loads(arm, rows, k)
        np.testing.assert_allclose(by_axial.position[k], inserted(arm, rows.q[k] + c * torques).translation, atol=1e-12)
        leaning = {j: c[j] * np.array([0, 0, 0, *wrenches[j][3:5], 0]) for j in range(5)}
        np.testing.assert_allclose(by_radial.position[k], inserted(arm, rows.q[k], leaning).translation, atol=1e-12)
        tipped = np.array([0, 0, 0, 1e-5 * root[3], 2e-5 * root[4], 0])
        np.testing.assert_allclose(by_base.position[k], inserted(arm, rows.q[k], base=tipped).translation, atol=1e-12)


@pytest.mark.parametrize("prismatic", [False, True])
def test_a_wrong_payload_shows_as_the_compliance_times_its_extra_load(prismatic: bool) -> None:
    arm, rows = random_arm(4, prismatic=prismatic)
    rows = replace(rows, qd=np.zeros_like(rows.q), qdd=np.zeros_like(rows.q))
    c = (1e-5, 2e-5, 3e-5, 4e-5, 5e-5)
    effect = effect_on(arm, "payload_error", compliances=c)
    shift = np.array([0.01, -0.02, 0.03])
    heavier = tool_with(arm, effect, {"payload_mass": 0.5}, rows)
    names = ("payload_com_x", "payload_com_y", "payload_com_z")
    elsewhere = tool_with(arm, effect, dict(zip(names, shift, strict=True)), rows)
    assert rows.payload_kg is not None
    assert rows.payload_com is not None
    for k, (kg, place) in enumerate(zip(rows.payload_kg, rows.payload_com, strict=True)):
        stated, *_ = loads(arm, rows, k)
        extra, *_ = loads(arm, rows, k, kg + 0.5 * (kg > 0))
        moved, *_ = loads(arm, rows, k, kg, place + shift)
        for tool, true in ((heavier, extra), (elsewhere, moved)):
            expected = inserted(arm, rows.q[k] + c * (true - stated)).translation
            np.testing.assert_allclose(tool.position[k], expected, atol=1e-12)
