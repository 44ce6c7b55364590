"""Effects of time, session and instrument: what the tool does when clocks, tables and markers are moved by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kilter_core.effects import make_effect
from kilter_core.errors import ObservationError, OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.effects.by_hand import effect_on, inserted, one_joint, robot_of, tool_with
from tests.core.truth import some_arm, some_pose

RNG = np.random.default_rng(8)
ARM = some_arm(RNG, 4)
T = np.linspace(0.0, 2.0, 9)


def swing(t: object) -> tuple[object, object]:
    """Joints and speeds of an arm that swings each joint at its own pace."""
    rates = np.array([0.5, 0.9, 1.3, 1.7])
    phase = np.outer(t, rates)
    return 0.6 * np.sin(phase), 0.6 * rates * np.cos(phase)


def test_late_positions_are_those_of_a_moment_later() -> None:
    q, qd = swing(T)
    tool = tool_with(ARM, effect_on(ARM, "time_offset"), {"time_offset": 1e-4}, Observations(q, qd=qd))
    np.testing.assert_allclose(tool.position, ARM.poses(swing(T + 1e-4)[0])[0], atol=2e-8)  # second order in dt
    assert np.max(np.abs(tool.position - ARM.poses(q)[0])) > 1e-5


def test_a_lagging_joint_is_where_its_setpoint_was() -> None:
    q, qd = swing(T)
    tool = tool_with(ARM, effect_on(ARM, "tracking_lag"), {"lag_2": 1e-4}, Observations(q, qd=qd))
    late = q.copy()
    late[:, 1] = swing(T - 1e-4)[0][:, 1]
    np.testing.assert_allclose(tool.position, ARM.poses(late)[0], atol=2e-8)


def test_the_base_drifts_in_its_own_axes() -> None:
    q = RNG.uniform(-2.0, 2.0, (3, 4))
    rows = Observations(q, t=np.array([1000.0, 1600.0, 4600.0]))
    effect = effect_on(ARM, "drift", rows)
    assert effect.to_document()["t0_s"] == 1000.0
    tool = tool_with(ARM, effect, {"drift_z": -1e-7, "drift_rx": 2e-7}, rows)
    for k, seconds in enumerate((0.0, 600.0, 3600.0)):
        twist = seconds * np.array([0.0, 0.0, -1e-7, 2e-7, 0.0, 0.0])
        np.testing.assert_allclose(tool.position[k], inserted(ARM, q[k], base=twist).translation, atol=1e-12)
    with pytest.raises(OptionError, match="t0_s"):
        tool_with(ARM, make_effect("drift"), {}, rows)


def test_a_scaled_instrument_stretches_all_distances() -> None:
    rows = Observations(RNG.uniform(-2.0, 2.0, (5, 4)))
    tool = tool_with(ARM, effect_on(ARM, "measurement_scale"), {"measurement_scale": 1e-3}, rows)
    np.testing.assert_allclose(tool.position, 1.001 * ARM.poses(rows.q)[0], atol=1e-13)


def test_markers_put_on_anew_shift_in_the_tool_frame() -> None:
    q = RNG.uniform(-2.0, 2.0, (4, 4))
    rows = Observations(q, session=np.array([2, 5, 9, 77]))
    effect = effect_on(ARM, "session_shift", Observations(q[:3], session=np.array([2, 5, 9])))
    assert effect.to_document()["sessions"] == [2, 5, 9]
    tool = tool_with(ARM, effect, {"session_5_x": 1e-3, "session_9_z": -2e-3}, rows)
    p, R = ARM.poses(q)
    shift = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 0.0, -2e-3], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(tool.position, p + np.einsum("nij,nj->ni", R, shift), atol=1e-12)
    with pytest.raises(OptionError, match="session numbers"):
        RobotModel(robot_of(ARM), (make_effect("session_shift"),))
    with pytest.raises(OptionError, match="two or more"):
        make_effect("session_shift", sessions=[3])


def test_the_unknown_field_shifts_the_tool_and_never_turns_it() -> None:
    arm = one_joint("rz", length=0.5)
    rows = Observations(np.array([[0.0], [math.pi / 2], [math.pi / 4]]))
    effect = effect_on(arm, "unknown_field", reach_m=0.5)
    tool = tool_with(arm, effect, {"field_x_y": 1e-3, "field_z_xy": 2e-3}, rows)
    root = math.sqrt(0.5)
    expected = [[0.5, 1e-3, 0.0], [1e-3, 0.5, 0.0], [root * (0.5 + 1e-3), root * (0.5 + 1e-3), 1e-3]]
    np.testing.assert_allclose(tool.position, expected, atol=1e-12)
    np.testing.assert_allclose(tool.rotation, arm.poses(rows.q)[1], atol=1e-15)


def test_the_unknown_field_of_a_tilted_base_follows_the_base() -> None:
    base = some_pose(RNG)
    level, tilted = one_joint("ry", length=0.7), one_joint("ry", length=0.7)
    object.__setattr__(tilted, "base", base)
    rows = Observations(np.array([[0.3], [1.2]]))
    values = {"field_x_x": 1e-3, "field_y_xz": -2e-3, "field_z_zz": 1e-3}
    at_level = tool_with(level, effect_on(level, "unknown_field"), values, rows).position
    at_tilted = tool_with(tilted, effect_on(tilted, "unknown_field"), values, rows).position
    np.testing.assert_allclose(at_tilted, at_level @ base.rotation.T + base.translation, atol=1e-12)


def test_options_that_cannot_be_are_refused_with_a_remedy() -> None:
    with pytest.raises(OptionError, match="1, 2 or 3"):
        make_effect("unknown_field", degree=7)
    with pytest.raises(OptionError, match="identify axial_compliance first"):
        effect_on(ARM, "payload_error", compliances=(1e-5,))
    with pytest.raises(OptionError, match="different joints"):
        make_effect("backlash", joints=[1, 1])
    with pytest.raises(OptionError, match="There is no effect"):
        make_effect("rust")
    with pytest.raises(ObservationError, match="qd1_deg_s"):
        tool_with(ARM, effect_on(ARM, "tracking_lag"), {}, Observations(np.zeros((1, 4))))


def test_an_identification_takes_sessions_and_start_of_drift_from_its_rows() -> None:
    q = RNG.uniform(-2.0, 2.0, (40, 4))
    rows = Observations(q, ARM.poses(q)[0], session=np.repeat([4, 6], 20), t=np.arange(40.0) + 1e9)
    found = identify(robot_of(ARM), rows, options=IdentifyOptions(effects=("session_shift", "drift")))
    shift, drift = found.calibration.model.effects
    assert shift.to_document()["sessions"] == [4, 6]
    assert drift.to_document()["t0_s"] == 1e9
    with pytest.raises(OptionError, match="upload a session in every row"):
        identify(robot_of(ARM), Observations(q, rows.position), options=IdentifyOptions(effects=("session_shift",)))
