"""Identification of arms whose truth is a Pinocchio model, with errors no convention knows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.errors import CancelledError, ObservationError, TooFewPosesError
from kilter_core.identify import Folds, Identification, IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, Step, small_pose, some_pose, ur10, with_hidden_errors

NOISE = 2e-5
TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.02, 0.10]))


def rms_per_axis(metrics: dict[str, Any], side: str = "validation", stage: str = "identified") -> float:
    return float(metrics[side][stage]["rms_mm"] * 1e-3 / np.sqrt(3.0))


def somewhere(seed: int, **options: Any) -> tuple[Robot, Arm, np.random.Generator]:
    """A UR10 with 36 hidden errors that stands and holds its tool somewhere unknown, and its drawing."""
    rng = np.random.default_rng(seed)
    nominal = ur10()
    true = replace(
        with_hidden_errors(nominal, rng, **options), base=some_pose(rng, 4.0), tool=TOOL * small_pose(rng, 0.02, 0.2)
    )
    return robot_from_document(nominal.document()), true, rng


@cache
def found(see: str) -> Identification:
    robot, true, rng = somewhere(1)
    train, held = (measured(true, joints(true, count, rng), rng, NOISE, see) for count in (250, 200))
    return identify(robot, train, held)


@pytest.mark.parametrize("see", ["position", "pose", "markers"])
def test_held_out_error_is_the_noise(see: str) -> None:
    result = found(see)
    assert rms_per_axis(result.metrics) == pytest.approx(NOISE, rel=0.12)
    assert result.noise_m == pytest.approx(NOISE, rel=0.08)
    assert rms_per_axis(result.metrics, stage="registration_only") > 20 * NOISE
    assert rms_per_axis(result.metrics, stage="nominal") > 0.1
    if see == "pose":
        turned = np.radians(result.metrics["validation"]["identified"]["orientation_deg"])
        assert turned == pytest.approx(NOISE * np.sqrt(8.0 / np.pi), rel=0.12)


@pytest.mark.parametrize("see", ["position", "pose", "markers"])
def test_the_same_arm_stays_found_when_it_is_drawn_another_way(see: str) -> None:
    """Six elements a joint instead of a DH row: three times the parameters, most of them aliases, the same poses."""
    _, true, rng = somewhere(1)
    drawn = tuple(replace(s, value=0.0) if s.name.startswith("hidden") else s for s in true.steps)
    robot = robot_from_document(replace(ur10(), steps=drawn).document())
    train, held = (measured(true, joints(true, count, rng), rng, NOISE, see) for count in (250, 100))
    result = identify(robot, train, held)
    assert len(result.free_names) > 60
    assert rms_per_axis(result.metrics) == pytest.approx(NOISE, rel=0.15)
    assert result.null_directions


def fixed_frames(seed: int) -> tuple[Robot, Arm, dict[str, float], np.random.Generator]:
    """A UR10 in a known place with a known tool; its errors are errors of its table."""
    rng = np.random.default_rng(seed)
    arm = ur10(base=some_pose(rng, 2.0), tool=TOOL)
    errors = table_errors(arm, rng)
    return robot_from_document(arm.document()), arm.moved(errors), errors, rng


FIXED = IdentifyOptions(base="fixed", tool="fixed")


def scores(seed: int, see: str = "position") -> NDArray[np.float64]:
    """Error over standard deviation along every direction that the data taught."""
    robot, true, errors, rng = fixed_frames(seed)
    result = identify(robot, measured(true, joints(true, 60, rng), rng, NOISE, see), None, FIXED)
    model = result.calibration.model
    wrong = np.array(
        [result.calibration.values[model.names.index(n)] - model.parameter(n).value - errors[n] for n in errors]
    )
    assert tuple(errors) == result.free_names
    prior = result.fit.problem.prior_sigma
    variance, directions = np.linalg.eigh(result.covariance / np.outer(prior, prior))
    taught = variance < 1e-3
    assert taught.sum() >= 20
    return np.asarray((directions[:, taught].T @ (wrong / prior)) / np.sqrt(variance[taught]))


@pytest.mark.parametrize("see", ["position", "pose"])
def test_parameters_are_found_within_their_uncertainty(see: str) -> None:
    assert np.max(np.abs(scores(11, see))) < 4.0


def test_ninety_five_percent_intervals_cover_ninety_five_percent() -> None:
    pooled = np.concatenate([scores(seed) for seed in range(30)])
    assert np.mean(np.abs(pooled) < 1.96) == pytest.approx(0.95, abs=0.025)
    assert np.std(pooled) == pytest.approx(1.0, abs=0.06)


def test_rows_report_the_truth_in_mm_and_degrees_with_their_sigma() -> None:
    robot, true, errors, rng = fixed_frames(12)
    result = identify(robot, measured(true, joints(true, 100, rng), rng, NOISE, "pose"), None, FIXED)
    steps = {s.name: s for s in true.steps}
    known = [row for row in result.to_document()["parameters"] if row["identifiable"]]
    assert len(known) >= 20
    for row in known:
        step = steps[row["name"]]
        assert row["unit"] == ("deg" if step.axis[0] == "r" else "mm")
        wire = Arm.wire(row["unit"], step.value)
        assert abs(row["value"] - wire) < 4.0 * row["sigma"] + 1e-9, row["name"]
        assert row["nominal"] == pytest.approx(Arm.wire(row["unit"], step.value - errors[row["name"]]), abs=1e-12)
        assert row["plausible"]


@pytest.mark.parametrize(("base", "tool"), [("free", "free"), ("free", "fixed"), ("fixed", "free"), ("fixed", "fixed")])
def test_base_and_tool_free_or_fixed(base: str, tool: str) -> None:
    robot, true, _, rng = fixed_frames(13)
    true = replace(true, base=some_pose(rng, 3.0) if base == "free" else true.base)
    true = replace(true, tool=true.tool * small_pose(rng, 0.01, 0.1) if tool == "free" else true.tool)
    train, held = (measured(true, joints(true, count, rng), rng, NOISE, "pose") for count in (120, 100))
    result = identify(robot, train, held, IdentifyOptions(base=base, tool=tool))
    assert rms_per_axis(result.metrics) == pytest.approx(NOISE, rel=0.15)
    assert any(n.startswith("base_") for n in result.free_names) == (base == "free")
    assert any(n.startswith("tool_") for n in result.free_names) == (tool == "free")
    if base == "fixed":
        np.testing.assert_array_equal(result.calibration.model.T_base, robot.T_base)


def test_level_1_finds_offsets_and_level_2_what_they_leave() -> None:
    rng = np.random.default_rng(14)
    arm = ur10(tool=TOOL)
    offsets = {f"theta_offset_{j}": float(rng.normal(0.0, 2e-3)) for j in range(1, 7)}
    robot, true = robot_from_document(arm.document()), arm.moved(offsets)
    train, held = (measured(true, joints(true, count, rng), rng, NOISE) for count in (60, 60))
    one = identify(robot, train, held, IdentifyOptions(level=1, base="fixed", tool="fixed"))
    assert one.free_names == tuple(offsets)
    assert rms_per_axis(one.metrics) == pytest.approx(NOISE, rel=0.15)
    bent = true.moved({"alpha_3": 1e-3})
    train, held = (measured(bent, joints(bent, count, rng), rng, NOISE) for count in (60, 60))
    one, two = (identify(robot, train, held, IdentifyOptions(level=k, base="fixed", tool="fixed")) for k in (1, 2))
    assert rms_per_axis(one.metrics) > 4 * NOISE
    assert rms_per_axis(two.metrics) == pytest.approx(NOISE, rel=0.25)


def test_fixed_parameters_stay_at_their_start() -> None:
    robot, true, _, rng = fixed_frames(15)
    train = measured(true, joints(true, 60, rng), rng, NOISE)
    first = identify(robot, train, None, FIXED)
    again = identify(robot, train, None, replace(FIXED, fix=("alpha_*", "d_*")), start=first.calibration)
    model = again.calibration.model
    held = [k for k, n in enumerate(model.names) if n.startswith(("alpha_", "d_"))]
    np.testing.assert_array_equal(again.calibration.values[held], first.calibration.values[held])
    assert not {model.names[k] for k in held} & set(again.free_names)


def test_huber_shrugs_off_two_percent_of_outliers() -> None:
    robot, true, rng = somewhere(16)
    train, held = (measured(true, joints(true, count, rng), rng, NOISE) for count in (300, 150))
    assert train.position is not None
    hit = rng.choice(300, 6, replace=False)
    position = train.position.copy()
    position[hit] += rng.normal(0.0, 5e-3, (6, 3))
    spoilt = replace(train, position=position)
    plain, robust = (identify(robot, spoilt, held, IdentifyOptions(loss=loss)) for loss in ("linear", "huber"))
    assert rms_per_axis(robust.metrics) == pytest.approx(NOISE, rel=0.2)
    assert rms_per_axis(plain.metrics) > 4 * NOISE
    assert robust.noise_m == pytest.approx(NOISE, rel=0.2)


@pytest.mark.parametrize("validation", [0.3, Folds(4)])
def test_a_fraction_or_folds_hold_out_the_same_truth(validation: float | Folds) -> None:
    robot, true, rng = somewhere(17)
    train = measured(true, joints(true, 200, rng), rng, NOISE)
    result = identify(robot, train, validation)
    assert rms_per_axis(result.metrics) == pytest.approx(NOISE, rel=0.2)
    assert result.metrics["validation"]["n"] == (200 if isinstance(validation, Folds) else 60)


def test_too_few_poses_are_refused_with_the_number_needed() -> None:
    robot, true, _, rng = fixed_frames(18)
    q = np.repeat(joints(true, 8, rng), 10, axis=0)  # ten repeats do not make a pose ten poses
    with pytest.raises(TooFewPosesError, match=r"8 distinct poses.*at least 9 poses") as refused:
        identify(robot, measured(true, q, rng, NOISE), None, FIXED)
    assert refused.value.context == {"poses": 8, "needed": 9, "free": 26}


def test_a_joint_that_never_moves_is_named_and_the_rest_is_identified() -> None:
    robot, true, rng = somewhere(19)
    q = joints(true, 400, rng)
    q[:, 3] = 0.7
    train, held = measured(true, q[:250], rng, NOISE, "pose"), measured(true, q[250:], rng, NOISE, "pose")
    document = (result := identify(robot, train, held)).to_document()
    assert rms_per_axis(result.metrics) == pytest.approx(NOISE, rel=0.15)
    warned = [w for w in document["warnings"] if w["code"] == "joint_never_moves"]
    assert [w["joint"] for w in warned] == ["j4"]
    rows = {row["name"]: row["identifiable"] for row in document["parameters"]}
    assert not rows["theta_offset_4"]
    assert rows["theta_offset_2"]
    assert rows["a_2"]
    assert any("theta_offset_4" in d["sentence"] for d in document["null_directions"])


def test_a_tool_point_on_the_last_axis_leaves_orientation_alone() -> None:
    rng = np.random.default_rng(20)
    on_axis = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.12]))
    nominal = ur10(tool=on_axis)
    # A wave in two joints stands for physics the model has not: structured, so it pulls at whatever is free.
    true = with_hidden_errors(replace(nominal, base=some_pose(rng, 3.0)), rng, 3e-4, 3e-4)
    q = joints(true, 500, rng)
    waved = q + 4e-4 * np.sin(2.0 * q) * [0, 1, 1, 0, 0, 0]
    position = true.poses(waved)[0] + rng.normal(0.0, NOISE, (500, 3))
    result = identify(robot_from_document(nominal.document()), Observations(q, position=position))
    unobservable = [d for d in result.null_directions if any(name == "theta_offset_6" for name, _ in d.weights)]
    assert unobservable
    rotation = true.poses(waved)[1]

    def turned(predicted: NDArray[np.float64]) -> float:
        # Positions never saw how the tool is mounted: compare after the one turn that fits best.
        mount = np.mean(predicted.transpose(0, 2, 1) @ rotation, axis=0)
        U, _, Vt = np.linalg.svd(mount)
        best = predicted @ (U @ Vt)
        return float(
            np.degrees(np.mean([np.linalg.norm(pin.log3(a @ b.T)) for a, b in zip(best, rotation, strict=True)]))
        )

    registered = identify(
        robot_from_document(nominal.document()),
        Observations(q, position=position),
        None,
        IdentifyOptions(free=("theta_offset_1",)),
    )
    before = turned(registered.calibration.predict(Observations(q)).rotation)
    after = turned(result.calibration.predict(Observations(q)).rotation)
    assert after < before + 0.02
    wrist = result.calibration.values[result.calibration.names.index("theta_offset_6")]
    assert abs(wrist) < np.radians(0.05)


def test_repeats_tell_the_noise_and_their_absence_is_said() -> None:
    robot, true, _, rng = fixed_frames(21)
    q = np.tile(joints(true, 60, rng), (3, 1))
    repeated = identify(robot, measured(true, q, rng, NOISE), None, FIXED)
    assert repeated.noise_source == "repeats"
    assert repeated.noise_m == pytest.approx(NOISE, rel=0.12)
    single = identify(robot, measured(true, q[:60], rng, NOISE), None, FIXED)
    assert single.noise_source == "residuals of the fit"
    assert single.noise_m == pytest.approx(NOISE, rel=0.15)
    assert "no_repeats" in {w["code"] for w in single.to_document()["warnings"]}


def test_sigma_columns_weigh_the_rows() -> None:
    robot, true, _, rng = fixed_frames(22)
    sigma = np.where(np.arange(120)[:, None] < 60, 2e-5, 5e-4) * np.ones((120, 3))
    q, held = joints(true, 120, rng), joints(true, 200, rng)
    position = true.poses(q)[0] + rng.normal(size=(120, 3)) * sigma
    clean = Observations(held, position=true.poses(held)[0])
    told, untold = (
        rms_per_axis(identify(robot, Observations(q, position=position, sigma=s), clean, FIXED).metrics)
        for s in (sigma, None)
    )
    assert told < untold / 4.0
    assert told < 2e-5


def test_progress_is_told_and_can_cancel() -> None:
    robot, true, _, rng = fixed_frames(23)
    train = measured(true, joints(true, 40, rng), rng, NOISE)
    heard: list[float] = []
    identify(robot, train, 0.25, FIXED, progress=lambda fraction, stage: heard.append(fraction))
    assert heard[0] < heard[-1] <= 1.0

    def stop(fraction: float, stage: str) -> None:
        if stage.startswith("fit"):
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        identify(robot, train, 0.25, FIXED, progress=stop)


def test_a_fit_is_the_same_every_time() -> None:
    robot, true, rng = somewhere(24)
    train = measured(true, joints(true, 80, rng), rng, NOISE)
    first, again = (identify(robot, train, 0.25).calibration.values for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_nothing_measured_is_refused() -> None:
    robot, true, _, rng = fixed_frames(25)
    with pytest.raises(ObservationError, match="no measured position"):
        identify(robot, Observations(joints(true, 60, rng)))
    with pytest.raises(ObservationError, match="direction"):
        identify(robot, measured(true, joints(true, 60, rng), rng), None, IdentifyOptions(effects=("backlash",)))


def test_a_scara_with_a_sliding_joint_is_found() -> None:
    rng = np.random.default_rng(26)
    steps = (
        Step("tz", 0.3, name="d_1"), Step("rz", 0.0, 0, 1.0, "offset_1"), Step("tx", 0.4, name="a_1"),
        Step("rx", 0.0, name="alpha_1"), Step("ry", 0.0, name="beta_1"),
        Step("rz", 0.0, 1, 1.0, "offset_2"), Step("tx", 0.3, name="a_2"), Step("rx", np.pi, name="alpha_2"),
        Step("ry", 0.0, name="beta_2"), Step("tz", 0.0, 2, 1.0, "offset_3"), Step("rz", 0.0, 3, -1.0, "offset_4"),
    )  # fmt: skip
    nominal = Arm(steps, 4, tool=pin.SE3(np.eye(3), np.array([0.03, 0.0, 0.05])))
    true = replace(nominal.moved(table_errors(nominal, rng)), base=some_pose(rng, 2.0))
    q = rng.uniform([-2, -2, 0.0, -3], [2, 2, 0.2, 3], (160, 4))
    train, held = measured(true, q[:100], rng, NOISE), measured(true, q[100:], rng, NOISE)
    result = identify(robot_from_document(nominal.document()), train, held)
    assert rms_per_axis(result.metrics) == pytest.approx(NOISE, rel=0.15)
