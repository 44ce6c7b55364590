"""Effects on the joint reading: discs, couplings, gears and springs built from their own geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import Effect, make_effect
from kilter_core.errors import OptionError
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.effects.by_hand import effect_on, one_joint, robot_of
from tests.core.truth import Arm, Step

Floats = NDArray[np.float64]
TURN = np.linspace(-math.pi, math.pi, 721)[:-1]


def added(arm: Arm, effect: Effect, values: list[float], rows: Observations) -> Floats:
    """What the effect adds to the joints (N, n)."""
    model = RobotModel(robot_of(arm), (effect,))
    whole = np.concatenate([model.values0()[: model.n_geometric], values])
    return model.link_angles(rows, whole) - rows.q


def swept(arm: Arm, effect: Effect, values: list[float], q: Floats = TURN) -> Floats:
    """The same for a sweep of the first joint (N,)."""
    rows = Observations(np.column_stack([q] + [np.zeros_like(q)] * (arm.n - 1)))
    return added(arm, effect, values, rows)[:, 0]


def test_an_encoder_disc_off_centre_reads_eccentrically() -> None:
    e, R, phase = 1e-5, 0.03, 0.8
    true = TURN
    centre = e * np.array([np.cos(true + phase), np.sin(true + phase)])
    # The head stands at (R, 0); the disc reads minus the angle of the head in its own turned frame.
    reading = true - np.arctan2(-centre[1], R - centre[0])
    arm = one_joint("rz")
    found = swept(arm, effect_on(arm, "eccentricity"), [-e / R * math.cos(phase), -e / R * math.sin(phase)], reading)
    np.testing.assert_allclose(found, true - reading, atol=2.0 * (e / R) ** 2)


def test_a_tilted_universal_joint_errs_twice_per_turn() -> None:
    tilt = 0.05
    out = np.arctan2(np.sin(TURN) * math.cos(tilt), np.cos(TURN))
    arm = one_joint("rz")
    found = swept(arm, effect_on(arm, "second_harmonic"), [-(math.tan(tilt / 2.0) ** 2), 0.0])
    np.testing.assert_allclose(found, np.angle(np.exp(1j * (out - TURN))), atol=math.tan(tilt / 2.0) ** 4)


def test_gear_error_repeats_with_every_turn_of_the_motor() -> None:
    arm = one_joint("rz")
    effect = effect_on(arm, "gear_error", joints=[0], ratios=(100.0,))
    values = [1e-4, 0.0, 0.0, 3e-5]  # once per motor turn, and twice
    motor = np.linspace(0.0, 2.0 * math.pi, 9)
    found = swept(arm, effect, values, motor / 100.0)
    np.testing.assert_allclose(found, swept(arm, effect, values, (motor + 2.0 * math.pi * 7) / 100.0), atol=1e-15)
    np.testing.assert_allclose(found[[0, 2, 4, 6]], [3e-5, 1e-4 - 3e-5, 3e-5, -1e-4 - 3e-5], atol=1e-15)


def test_gear_ratios_come_from_the_robot() -> None:
    ur10 = robot_from_document(preset_document("ur10"))
    effect = make_effect("gear_error", joints=[1, 4]).configure_for_robot(ur10)
    assert effect.to_document()["ratios"] == [101.0, 101.0]
    with pytest.raises(OptionError, match="Give gear_ratio in the robot's joints"):
        RobotModel(robot_from_document(preset_document("katana450-chapter5")), (make_effect("gear_error"),))
    with pytest.raises(OptionError, match="one ratio for each"):
        make_effect("gear_error", joints=[1, 4], ratios=(101.0,))


def test_a_scaled_encoder_turns_further_than_it_reads() -> None:
    arm = one_joint("rz")
    assert swept(arm, effect_on(arm, "encoder_scale"), [0.01], np.array([0.0, math.pi / 2]))[1] == pytest.approx(
        0.01 * math.pi / 2
    )


def test_a_wrist_joint_follows_the_one_before_it() -> None:
    arm = Arm(tuple(Step("rz", 0.0, j) for j in range(6)), 6)
    q = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
    found = added(arm, effect_on(arm, "joint_coupling", joints=[4, 5], drivers=(3, 3)), [0.01, -0.02], Observations(q))
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.0, 0.0, 0.004, -0.008]], atol=1e-15)
    usual = effect_on(arm, "joint_coupling")
    assert usual.to_document()["drivers"] == [1, 2, 3, 4, 5]
    for wrong in ({"joints": [2], "drivers": (2,)}, {"joints": [2, 3], "drivers": (1,)}, {"drivers": (1,)}):
        with pytest.raises(OptionError):
            effect_on(arm, "joint_coupling", **wrong)
    with pytest.raises(OptionError, match="Give drivers"):
        effect_on(arm, "joint_coupling", joints=[0])


def test_a_balancer_pulls_its_joint_down_the_slope_of_its_energy() -> None:
    stiffness, compliance, a, b, phase, free = 8000.0, 2e-6, 0.5, 0.2, 0.7, 0.25

    def energy(q: Floats) -> Floats:
        pins = np.array([a, 0.0]) - b * np.column_stack([np.cos(q + phase), np.sin(q + phase)])
        return 0.5 * stiffness * (np.linalg.norm(pins, axis=1) - free) ** 2

    torque = -(energy(TURN + 1e-5) - energy(TURN - 1e-5)) / 2e-5
    arm = one_joint("rz")
    effect = effect_on(arm, "gravity_spring", arms_m=(a, b), angle_rad=phase, free_length_m=free)
    found = swept(arm, effect, [compliance * stiffness * a * b])
    np.testing.assert_allclose(found, compliance * torque, atol=1e-9)
    assert np.ptp(found) > 1e-3


def test_without_pins_a_balancer_is_a_spring_of_no_free_length() -> None:
    arm = one_joint("rz")
    pinned = swept(arm, effect_on(arm, "gravity_spring", arms_m=(0.5, 0.2), angle_rad=0.7), [2e-3])
    found = swept(arm, effect_on(arm, "gravity_spring"), [-2e-3 * math.cos(0.7), -2e-3 * math.sin(0.7)])
    np.testing.assert_allclose(found, pinned, atol=1e-15)
    two = Arm(tuple(Step("rz", 0.0, j) for j in range(3)), 3)
    assert effect_on(two, "gravity_spring").joints == (1,)


def test_backlash_lags_behind_the_motion_from_both_sides() -> None:
    arm = one_joint("rz")
    rows = Observations(np.zeros((3, 1)), direction=np.array([[1.0], [-1.0], [0.0]]))
    played = added(arm, effect_on(arm, "backlash"), [-1e-3], rows)[:, 0]
    np.testing.assert_allclose(played, [-5e-4, 5e-4, 0.0])  # a play of 1e-3: the link trails by half of it
    wound = added(arm, effect_on(arm, "friction_windup"), [-5e-4], rows)[:, 0]
    np.testing.assert_allclose(wound, played)


def test_the_unknown_curve_leaves_the_named_orders_alone() -> None:
    arm = one_joint("rz")
    effect = effect_on(arm, "unknown_joint_curve")
    found = swept(arm, effect, [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4, 7e-4, 8e-4])
    spectrum = np.fft.rfft(np.roll(found, -360)) / 360.0  # the sweep starts at -180 degrees
    expected = np.zeros(8, dtype=complex)
    expected[3:7] = [2e-4 - 1e-4j, 4e-4 - 3e-4j, 6e-4 - 5e-4j, 8e-4 - 7e-4j]
    np.testing.assert_allclose(spectrum[:8], expected, atol=1e-12)


def test_the_unknown_curve_of_two_joints() -> None:
    arm = Arm((Step("rz", 0.0, 0), Step("tx", 0.1), Step("ry", 0.0, 1), Step("tx", 0.0, 2)), 3)
    effect = effect_on(arm, "unknown_joint_curve", joints=[0], orders=(), partner=1)
    q = np.array([[math.pi / 2, math.pi / 2, 0.3], [math.pi / 2, -math.pi / 6, 0.1], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(added(arm, effect, [1e-3], Observations(q))[:, 0], [1e-3, -5e-4, 0.0], atol=1e-15)
    assert effect_on(arm, "unknown_joint_curve").joints == (0, 1)
    assert effect_on(arm, "unknown_joint_curve", orders=(), partner=1).joints == (0,)
    for wrong in ({"joints": [0], "partner": 2}, {"joints": [2]}, {"joints": [0], "partner": 0}, {"orders": ()}):
        with pytest.raises(OptionError):
            effect_on(arm, "unknown_joint_curve", **wrong)


def test_a_magnet_off_its_axis_errs_by_a_curve_of_waves() -> None:
    shift, arm = 0.1, one_joint("rz")
    error = np.arctan2(shift * np.sin(TURN), 1.0 + shift * np.cos(TURN))  # of the field's direction at the chip
    waves = [a for m in range(1, 5) for a in (-((-shift) ** m) / m, 0.0)]  # the series of the same
    found = swept(arm, effect_on(arm, "encoder_curve", orders=(1, 2, 3, 4)), waves)
    np.testing.assert_allclose(found, error, atol=shift**5 / 4.0)
    for wrong in ((), (0, 1), (1, 1), (13,)):
        with pytest.raises(OptionError, match="orders"):
            make_effect("encoder_curve", orders=wrong)


def test_a_local_bump_is_nothing_elsewhere() -> None:
    arm = one_joint("rz")
    found = swept(arm, effect_on(arm, "local_bump", centre_rad=0.5, half_width_rad=0.2), [1e-3])
    assert not found[np.abs(TURN - 0.5) > 0.2].any()
    assert found.max() == pytest.approx(1e-3, rel=1e-3)
    half = np.interp(0.5 + 0.2 * math.sqrt(1.0 - math.sqrt(0.5)), TURN, found)  # where (1 - u^2)^2 is a half
    assert half == pytest.approx(5e-4, rel=1e-2)
    with pytest.raises(OptionError, match="above 0"):
        make_effect("local_bump", half_width_rad=0.0)
