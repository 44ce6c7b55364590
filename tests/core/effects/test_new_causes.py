"""Causes of time, temperature and load at single places: arms moved by hand, torques drawn by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kilter_core.arm.run_time import Conditions, RunTimeForm
from kilter_core.effects import make_effect
from kilter_core.errors import OptionError
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.effects.by_hand import G, effect_on, inserted, one_joint, robot_of, tool_with
from tests.core.truth import Arm, Step, some_arm

RNG = np.random.default_rng(21)
ARM = some_arm(RNG, 4)
HOURS = np.array([0.0, 0.5, 2.0])


def turning() -> Arm:
    """Two joints that turn, a slide, and links between them."""
    steps = (
        Step("tz", 0.4), Step("rz", 0.0, 0), Step("tx", 0.3), Step("ry", 0.0, 1), Step("tx", 0.25),
        Step("tz", 0.0, 2), Step("tx", 0.1),
    )  # fmt: skip
    return Arm(steps, 3)


def test_the_zero_of_a_joint_moves_with_time() -> None:
    q = RNG.uniform(-1.0, 1.0, (3, 3))
    rows = Observations(q, t=7200.0 + 3600.0 * HOURS)
    effect = effect_on(turning(), "zero_drift", rows)
    tool = tool_with(turning(), effect, {"zero_drift_2": 1e-7, "zero_drift_3": -2e-8}, rows)
    late = q + 3600.0 * HOURS[:, None] * np.array([0.0, 1e-7, -2e-8])
    np.testing.assert_allclose(tool.position, turning().poses(late)[0], atol=1e-13)
    assert [p.unit for p in effect.parameters(robot_of(turning()))] == ["rad/s", "rad/s", "m/s"]
    with pytest.raises(OptionError, match="t0_s"):
        tool_with(turning(), make_effect("zero_drift"), {}, rows)


def test_the_zero_of_a_joint_moves_with_temperature() -> None:
    q = RNG.uniform(-1.0, 1.0, (2, 3))
    rows = Observations(q, temperature_c=np.array([25.0, 17.0]))
    tool = tool_with(turning(), effect_on(turning(), "zero_thermal"), {"zero_thermal_1": 2e-5}, rows)
    warm = q + np.array([[5.0], [-3.0]]) * np.array([2e-5, 0.0, 0.0])
    np.testing.assert_allclose(tool.position, turning().poses(warm)[0], atol=1e-13)


def test_the_base_moves_with_temperature() -> None:
    q = RNG.uniform(-1.0, 1.0, (2, 3))
    rows = Observations(q, temperature_c=np.array([25.0, 17.0]))
    tool = tool_with(turning(), effect_on(turning(), "thermal_drift"), {"thermal_drift_z": 1e-4}, rows)
    np.testing.assert_allclose(tool.position, turning().poses(q)[0] + [[0, 0, 5e-4], [0, 0, -3e-4]], atol=1e-13)
    tool = tool_with(turning(), effect_on(turning(), "thermal_drift"), {"thermal_drift_rz": 2e-5}, rows)
    warm = q + np.array([[5.0], [-3.0]]) * np.array([2e-5, 0.0, 0.0])  # the first joint is vertical: it looks the same
    np.testing.assert_allclose(tool.position, turning().poses(warm)[0], atol=1e-13)


def test_one_link_grows_and_the_others_do_not() -> None:
    arm = Arm((Step("rz", 0.0, 0), Step("tx", 0.3, name="a"), Step("ry", 0.0, 1), Step("tx", 0.25, name="b")), 2)
    q = RNG.uniform(-1.0, 1.0, (3, 2))
    rows = Observations(q, temperature_c=np.full(3, 30.0))
    grown = effect_on(arm, "link_growth")
    np.testing.assert_allclose(
        tool_with(arm, grown, {"link_expansion_2": 2e-5}, rows).position,
        arm.moved({"b": 0.25 * 2e-4}).poses(q)[0], atol=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(
        tool_with(arm, grown, {"link_expansion_1": 2e-5}, rows).position,
        arm.moved({"a": 0.3 * 2e-4}).poses(q)[0], atol=1e-13,
    )  # fmt: skip
    short = Arm((Step("rz", 0.0, 0), Step("ry", 0.0, 1), Step("tx", 0.25)), 2)
    assert effect_on(short, "link_growth").joints == (1,)
    with pytest.raises(OptionError, match="no length"):
        effect_on(short, "link_growth", joints=[0])


def test_the_base_settles_towards_its_end() -> None:
    q = RNG.uniform(-2.0, 2.0, (3, 4))
    rows = Observations(q, t=100.0 + 3600.0 * HOURS)
    effect = effect_on(ARM, "settling", rows, tau_s=1800.0)
    tool = tool_with(ARM, effect, {"settling_1800s_y": 2e-4, "settling_1800s_rz": -1e-4}, rows)
    for k, share in enumerate((0.0, 1.0 - math.exp(-1.0), 1.0 - math.exp(-4.0))):
        twist = share * np.array([0.0, 2e-4, 0.0, 0.0, 0.0, -1e-4])
        np.testing.assert_allclose(tool.position[k], inserted(ARM, q[k], base=twist).translation, atol=1e-12)
    assert effect_on(ARM, "settling", rows).to_document()["tau_s"] == 1400.0  # a fifth of two hours, in two digits
    with pytest.raises(OptionError, match="time constant"):
        RobotModel(robot_of(ARM), (make_effect("settling"),))
    with pytest.raises(OptionError, match="above 0"):
        make_effect("settling", tau_s=-5.0)


def test_the_base_walks_straight_on_between_the_knots() -> None:
    q = RNG.uniform(-2.0, 2.0, (5, 4))
    rows = Observations(q, t=np.array([0.0, 50.0, 100.0, 250.0, 400.0]))
    effect = effect_on(ARM, "random_walk", rows, knots_s=(0.0, 100.0, 400.0))
    tool = tool_with(ARM, effect, {"walk_1_x": 1e-4, "walk_2_x": -3e-4, "walk_2_z": 2e-4}, rows)
    for k, (x, z) in enumerate([(0.0, 0.0), (5e-5, 0.0), (1e-4, 0.0), (-5e-5, 1e-4), (-2e-4, 2e-4)]):
        twist = np.array([x, 0.0, z, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(tool.position[k], inserted(ARM, q[k], base=twist).translation, atol=1e-12)
    first, second = (p.prior_sigma for p in effect.parameters(robot_of(ARM))[::3])
    assert second == pytest.approx(first * math.sqrt(3.0))  # the variance grows with the time
    for wrong in ((5.0,), (3.0, 3.0), (4.0, 1.0)):
        with pytest.raises(OptionError, match="knots_s"):
            make_effect("random_walk", knots_s=wrong)
    with pytest.raises(OptionError, match="knots_s"):
        RobotModel(robot_of(ARM), (make_effect("random_walk"),))
    for wrong in (0, 51):
        with pytest.raises(OptionError, match="give 1 to 50"):
            make_effect("random_walk", pieces=wrong)
    few = effect_on(ARM, "random_walk", rows, pieces=2)
    assert [p.name for p in few.parameters(robot_of(ARM))][::3] == ["walk2_1_x", "walk2_2_x"]


def test_a_column_bends_with_temperature() -> None:
    q = RNG.uniform(-2.0, 2.0, (2, 4))
    rows = Observations(q, temperature_c=np.array([20.0, 32.0]))
    effect = effect_on(ARM, "column_bending")
    tool = tool_with(ARM, effect, {"column_bending_x": 1e-5, "column_bending_y": -2e-5}, rows)
    for k, warmer in enumerate((0.0, 12.0)):
        twist = warmer * np.array([0.0, 0.0, 0.0, 1e-5, -2e-5, 0.0])
        np.testing.assert_allclose(tool.position[k], inserted(ARM, q[k], base=twist).translation, atol=1e-12)


def test_a_tool_sags_across_its_axis_under_the_payload() -> None:
    """An arm about y: at q the tool's z leans by q from upright, and the weight moves it down across that."""
    arm = Arm((Step("ry", 0.0, 0), Step("tz", 0.5)), 1)
    q = np.array([0.0, math.pi / 2, math.pi / 6, math.pi / 2])
    rows = Observations(q[:, None], payload_kg=np.array([4.0, 4.0, 4.0, 0.0]))
    tool = tool_with(arm, effect_on(arm, "tool_sag"), {"sag_per_kg": 1e-5}, rows)
    along = np.column_stack([np.sin(q), np.zeros(4), np.cos(q)])
    down = np.array([0.0, 0.0, -1.0])
    across = down - (along @ down)[:, None] * along
    sag = 4.0e-5 * np.array([1.0, 1.0, 1.0, 0.0])[:, None] * across
    np.testing.assert_allclose(tool.position, arm.poses(rows.q)[0] + sag, atol=1e-12)
    np.testing.assert_allclose(tool.rotation, arm.poses(rows.q)[1], atol=1e-12)
    with pytest.raises(OptionError, match="axis"):
        make_effect("tool_sag", axis=(0.0, 0.0, 0.0))


def test_a_turned_tool_sags_across_its_own_axis() -> None:
    """The same arm with an adapter whose z is the arm's x: now it sags when the arm is upright."""
    import pinocchio as pin

    arm = Arm(
        (Step("ry", 0.0, 0), Step("tz", 0.5)), 1, tool=pin.SE3(pin.exp3(np.array([0.0, math.pi / 2, 0.0])), np.zeros(3))
    )
    rows = Observations(np.array([[0.0], [math.pi / 2]]), payload_kg=np.full(2, 3.0))
    tool = tool_with(arm, effect_on(arm, "tool_sag"), {"sag_per_kg": 1e-5}, rows)
    moved = tool.position - arm.poses(rows.q)[0]
    np.testing.assert_allclose(moved, [[0.0, 0.0, -3e-5], [0.0, 0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("effect", "values", "joint", "turn"),
    [
        ("hardening", {"hardening_1": 1e-6}, "ry", lambda m, s: -1e-6 * m * abs(m)),
        ("strain_wave", {"strain_wave_10000_1": 2e-4}, "ry", lambda m, s: 2e-4 * math.tanh(m / 10.0)),
        ("direction_compliance", {"direction_compliance_1": 2e-6}, "ry", lambda m, s: 2e-6 * s * m),
    ],
)
def test_what_a_load_about_the_axis_does(effect: str, values: dict[str, float], joint: str, turn: object) -> None:
    """A mass m at l on an arm about y: the moment about the axis is m g l cos q, downwards positive."""
    arm = one_joint(joint, length=0.8, mass=5.0)
    q = np.array([0.0, 0.7, math.pi - 0.2, 0.0])
    side = np.array([1.0, -1.0, 1.0, -1.0])
    rows = Observations(q[:, None], direction=side[:, None])
    tool = tool_with(arm, effect_on(arm, effect), values, rows)
    moment = 5.0 * G * 0.8 * np.cos(q)
    after = q + np.array([turn(m, s) for m, s in zip(moment, side, strict=True)])  # type: ignore[operator]
    np.testing.assert_allclose(tool.position, arm.poses(after[:, None])[0], atol=1e-12)


def test_a_reading_changes_with_the_tilt_of_its_joint() -> None:
    """A mass at l on an upright joint: the moment across the axis has a fixed place in the joint that turns with it."""
    arm = one_joint("rz", length=0.8, mass=5.0)
    rows = Observations(np.array([[0.0], [1.1], [-2.0]]))
    # In the frame that turns with the joint the mass is along x, so its weight has the moment m g l about y.
    tool = tool_with(arm, effect_on(arm, "reading_tilt"), {"reading_tilt_x_1": 7e-6, "reading_tilt_y_1": 3e-6}, rows)
    np.testing.assert_allclose(tool.position, arm.poses(rows.q + 3e-6 * 5.0 * G * 0.8)[0], atol=1e-12)


def test_a_smooth_curve_lives_on_the_range_that_was_moved() -> None:
    arm = Arm((Step("rz", 0.0, 0), Step("tx", 0.1), Step("tz", 0.0, 1)), 2)
    q = np.array([[-0.5, 0.1], [0.5, 0.3], [1.5, 0.5]])
    effect = effect_on(arm, "unknown_smooth_curve", Observations(q), orders=(1, 3))
    assert effect.to_document()["centres"] == pytest.approx([0.5, 0.3])
    assert effect.to_document()["halves"] == pytest.approx([1.0, 0.2])
    model = RobotModel(robot_of(arm), (effect,))
    values = np.concatenate([model.values0()[: model.n_geometric], [1e-3, 0.0, 2e-3, 5e-6]])
    at = np.array([[0.0, 0.3], [1.0, 0.3], [9.0, 0.5]])
    found = model.link_angles(Observations(at), values) - at
    cubic = [1e-3 * u + 2e-3 * (5 * u**3 - 3 * u) / 2 for u in (-0.5, 0.5, 1.0)]  # held at its end outside
    np.testing.assert_allclose(found[:, 0], cubic, atol=1e-15)
    np.testing.assert_allclose(found[:, 1], [0.0, 0.0, 5e-6], atol=1e-15)
    assert [p.unit for p in effect.parameters(robot_of(arm))] == ["rad", "m", "rad", "m"]
    still = Observations(np.array([[0.1, 0.3], [0.9, 0.3]]))
    assert effect_on(arm, "unknown_smooth_curve", still).joints == (0,)
    with pytest.raises(OptionError, match="did not move"):
        effect_on(arm, "unknown_smooth_curve", still, joints=[1])
    for wrong in ({"orders": ()}, {"orders": (2, 2)}, {"orders": (0,)}, {"orders": (40,)}):
        with pytest.raises(OptionError, match="orders"):
            make_effect("unknown_smooth_curve", **wrong)


def test_a_link_lengthens_with_time() -> None:
    arm = Arm((Step("rz", 0.0, 0), Step("tx", 0.3, name="a"), Step("ry", 0.0, 1), Step("tx", 0.25, name="b")), 2)
    q = RNG.uniform(-1.0, 1.0, (3, 2))
    rows = Observations(q, t=100.0 + 3600.0 * HOURS)
    steady, settled = effect_on(arm, "link_lengthening", rows), effect_on(arm, "link_lengthening", rows, tau_s=1800.0)
    for k, hours in enumerate(HOURS):
        grown = arm.moved({"b": 0.25 * 1e-7 * 3600.0 * hours}).poses(q)[0][k]
        np.testing.assert_allclose(tool_with(arm, steady, {"link_rate_2": 1e-7}, rows).position[k], grown, atol=1e-13)
        grown = arm.moved({"a": 0.3 * 4e-4 * (1.0 - math.exp(-2.0 * hours))}).poses(q)[0][k]
        tool = tool_with(arm, settled, {"link_strain_1800s_1": 4e-4}, rows)
        np.testing.assert_allclose(tool.position[k], grown, atol=1e-13)
    with pytest.raises(OptionError, match="no length"):
        effect_on(Arm((Step("rz", 0.0, 0), Step("ry", 0.0, 1), Step("tx", 0.25)), 2), "link_lengthening", joints=[0])


def test_the_scale_of_the_instrument_follows_the_temperature() -> None:
    q = RNG.uniform(-1.0, 1.0, (2, 3))
    rows = Observations(q, temperature_c=np.array([25.0, 17.0]))
    tool = tool_with(turning(), effect_on(turning(), "scale_thermal"), {"scale_thermal": 1e-5}, rows)
    stretched = turning().poses(q)[0] * np.array([[1.0 + 5e-5], [1.0 - 3e-5]])
    np.testing.assert_allclose(tool.position, stretched, atol=1e-13)


@pytest.mark.parametrize("effect", ["thermal_growth", "link_growth", "zero_thermal", "column_bending"])
def test_a_law_of_temperature_whose_place_is_open_is_not_corrected(effect: str) -> None:
    robot = robot_of(turning())
    for corrected in (True, False):
        law = make_effect(effect, corrected=corrected).configure_for_robot(robot)
        form = RunTimeForm.empty(robot, Conditions(temperature_c=30.0))
        assert law.at_run_time(form, np.full(len(law.parameters(robot)), 1e-5)) is corrected
    assert make_effect(effect).to_document()["corrected"] is True
