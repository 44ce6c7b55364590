"""Evaluation on new measurements, with frames fitted anew, and its metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.errors import OptionError
from kilter_core.evaluate import evaluate
from kilter_core.identify import identify
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement.frames import Errors
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.truth import Arm, some_pose, ur10, with_hidden_errors

NOISE = 2e-5
MEAN_OF_NOISE_MM = NOISE * 1e3 * np.sqrt(8.0 / np.pi)
TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.02, 0.10]))


@pytest.fixture(scope="module")
def calibrated() -> tuple[Robot, Arm, Calibration]:
    rng = np.random.default_rng(0)
    true = with_hidden_errors(ur10(tool=TOOL, base=some_pose(rng, 3.0)), rng)
    robot = robot_from_document(ur10().document())
    return robot, true, identify(robot, measured(true, joints(true, 250, rng), rng, NOISE)).calibration


def test_new_poses_in_the_same_place(calibrated: tuple[Robot, Arm, Calibration]) -> None:
    _, true, calibration = calibrated
    rng = np.random.default_rng(1)
    found = evaluate(calibration, measured(true, joints(true, 150, rng), rng, NOISE))
    assert found["n"] == 150
    assert found["identified"]["mean_mm"] == pytest.approx(MEAN_OF_NOISE_MM, rel=0.15)
    assert found["registration_only"]["mean_mm"] > 10 * MEAN_OF_NOISE_MM
    assert found["nominal"]["mean_mm"] > 100.0


def test_a_tracker_set_up_anew_needs_its_base_fitted(calibrated: tuple[Robot, Arm, Calibration]) -> None:
    _, true, calibration = calibrated
    rng = np.random.default_rng(2)
    moved = replace(true, base=some_pose(rng, 3.0))
    seen = measured(moved, joints(moved, 150, rng), rng, NOISE)
    assert evaluate(calibration, seen)["identified"]["mean_mm"] > 100.0
    assert evaluate(calibration, seen, ["base"])["identified"]["mean_mm"] == pytest.approx(MEAN_OF_NOISE_MM, rel=0.15)


def test_another_reflector_needs_its_place_fitted_too(calibrated: tuple[Robot, Arm, Calibration]) -> None:
    _, true, calibration = calibrated
    rng = np.random.default_rng(3)
    moved = replace(true, base=some_pose(rng, 3.0), tool=true.tool * pin.SE3(np.eye(3), np.array([0.0, 0.03, 0.01])))
    seen = measured(moved, joints(moved, 150, rng), rng, NOISE)
    assert evaluate(calibration, seen, ["base"])["identified"]["mean_mm"] > 20 * MEAN_OF_NOISE_MM
    found = evaluate(calibration, seen, ["base", "tool"])["identified"]["mean_mm"]
    assert found == pytest.approx(MEAN_OF_NOISE_MM, rel=0.2)


def test_every_row_is_told_with_its_error(calibrated: tuple[Robot, Arm, Calibration]) -> None:
    _, true, calibration = calibrated
    rng = np.random.default_rng(6)
    rows = measured(true, np.repeat(joints(true, 30, rng), 2, axis=0), rng, NOISE)
    found = evaluate(calibration, rows)
    assert rows.position is not None
    expected = (rows.position - calibration.predict(rows).position) * 1e3
    np.testing.assert_allclose(np.stack([found["rows"][f"d{k}_mm"] for k in "xyz"], axis=1), expected, atol=1e-9)
    assert found["rows"]["row"] == list(range(1, 61))
    assert len(set(found["rows"]["pose"])) == 30
    assert found["rows"]["u95_x_mm"] == [None] * 60
    assert found["within_u95"] is None
    many = evaluate(calibration, measured(true, joints(true, 4100, rng), rng, NOISE))["rows"]
    assert (len(many["row"]), many["row"][0], many["row"][-1]) == (2000, 1, 4100)


def test_another_refit_is_refused(calibrated: tuple[Robot, Arm, Calibration]) -> None:
    _, true, calibration = calibrated
    rng = np.random.default_rng(4)
    with pytest.raises(OptionError, match="refit"):
        evaluate(calibration, measured(true, joints(true, 20, rng), rng), ["tool"])


def test_a_calibration_survives_its_document(calibrated: tuple[Robot, Arm, Calibration]) -> None:
    robot, true, calibration = calibrated
    again = Calibration.from_document(robot, calibration.to_document())
    q = joints(true, 20, np.random.default_rng(5))
    before, after = (c.predict(Observations(q)) for c in (calibration, again))
    np.testing.assert_allclose(after.position, before.position, atol=1e-14)
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-14)
    with pytest.raises(OptionError, match="bend_9"):
        Calibration.from_document(robot, {**calibration.to_document(), "values": {"bend_9": 1.0}})


def test_metrics_by_hand() -> None:
    points = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.0]]) * 1e-3
    found = Errors(points, np.radians([1.0, 2.0, 3.0, 6.0])).to_document()
    assert found["mean_mm"] == pytest.approx(2.0)
    assert found["rms_mm"] == pytest.approx(np.sqrt(30.0 / 4.0))
    assert found["max_mm"] == pytest.approx(5.0)
    assert found["p95_mm"] == pytest.approx(5.0 - 0.15 * 3.0)
    assert (found["x_mm"], found["y_mm"], found["z_mm"]) == pytest.approx((1.5, np.sqrt(5.0), 0.5))
    assert found["orientation_deg"] == pytest.approx(3.0)
    pooled = Errors.concatenate([Errors(points[:1], None), Errors(points[1:], None)])
    assert pooled.to_document()["mean_mm"] == pytest.approx(2.0)
    assert pooled.turns is None


@pytest.mark.parametrize("refit", [[], ["base", "tool"]])
def test_a_calibration_worse_than_none_is_warned_of_with_both_numbers(refit: list[str]) -> None:
    rng = np.random.default_rng(7)
    arm = ur10()
    robot = robot_from_document(arm.document())
    nominal = Calibration.nominal(robot)
    values = nominal.values.copy()
    values[list(nominal.names).index("theta_offset_3")] += 2e-3
    seen = measured(arm, joints(arm, 40, rng), rng, 3e-5)
    (said,) = evaluate(replace(nominal, values=values), seen, refit)["warnings"]
    assert said["code"] == "worse_than_without"
    assert said["identified_mm"] > 5 * said["simpler_mm"]
    assert f"{said['identified_mm']:.3g} mm" in said["message"]
    assert evaluate(nominal, seen, refit)["warnings"] == []


@pytest.mark.parametrize(
    ("turn", "by", "tool", "refit"),
    [(0.4, (1.5, -0.7, 0.2), (0, 0, 0), ["base"]), (0.0, (0, 0, 0), (0, 0.04, 0.01), ["base", "tool"])],
)
def test_rows_of_another_set_up_are_said_to_be_and_nothing_else(turn, by, tool, refit) -> None:
    rng = np.random.default_rng(9)
    arm = ur10()
    q = joints(arm, 40, rng)
    seen = measured(arm, q, rng, 3e-5)
    flange = Calibration.nominal(robot_from_document(arm.document())).predict(seen).rotation
    c, s = np.cos(turn), np.sin(turn)
    points = seen.position + flange @ np.array(tool)
    moved = replace(seen, position=points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + by)
    nominal = Calibration.nominal(robot_from_document(arm.document()))
    (said,) = evaluate(nominal, moved)["warnings"]
    assert (said["code"], said["refit"]) == ("set_up_elsewhere", refit)
    assert said["refitted_mm"] < 0.1 < 10 < said["version_mm"]
    assert evaluate(nominal, moved, said["refit"])["warnings"] == []  # the remedy it names


def test_an_arm_that_is_worn_is_not_said_to_stand_elsewhere() -> None:
    rng = np.random.default_rng(10)
    arm = ur10()
    worn = arm.moved({"theta_offset_1": 3e-3, "theta_offset_2": 2e-3, "theta_offset_3": 2e-3})
    seen = measured(worn, joints(arm, 40, rng), rng, 3e-5)
    codes = [w["code"] for w in evaluate(Calibration.nominal(robot_from_document(arm.document())), seen)["warnings"]]
    assert "set_up_elsewhere" not in codes


def test_intervals_that_do_not_cover_are_warned_of() -> None:
    rng = np.random.default_rng(8)
    arm = ur10()
    true = arm.moved({"a_2": 1e-3, "theta_offset_3": 1e-3})
    found = identify(robot_from_document(arm.document()), measured(true, joints(arm, 60, rng), rng, 3e-5))
    known = Predictive.from_document(found.predictive.to_document(), found.to_document())
    fresh = measured(true, joints(arm, 60, rng), rng, 3e-5)
    told = evaluate(found.calibration, fresh, [], known)
    assert told["within_u95"] > 0.9
    assert told["warnings"] == []
    worn = measured(true.moved({"theta_offset_2": 5e-4}), joints(arm, 60, rng), rng, 3e-5)
    told = evaluate(found.calibration, worn, [], known)
    (said,) = told["warnings"]
    assert (said["code"], said["within_u95"]) == ("intervals_too_narrow", told["within_u95"])
