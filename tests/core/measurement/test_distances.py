"""Absolute and relative calibration on one arm with hidden errors: base free, fixed, removed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError, TooFewPosesError
from kilter_core.identify import Folds, IdentifyOptions, identify
from kilter_core.measurement import Measurement
from kilter_core.measurement.distances import Distances
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_core.twin import thesis_katana
from tests.core.campaigns import MARKERS, joints, measured, table_errors
from tests.core.truth import some_pose, ur10

Floats = NDArray[np.float64]
NOISE = 2e-5


def campaign(see: str = "position", rows: int = 120, noise: float = NOISE) -> tuple[object, Observations, Observations]:
    rng = np.random.default_rng(4)
    arm = ur10()
    actual = arm.moved(table_errors(arm, rng))
    robot = robot_from_document(arm.document())
    # The instrument stands anywhere: only distances are the same in its frame.
    elsewhere = type(actual)(actual.steps, actual.n, some_pose(rng, 5.0), actual.tool)
    train = measured(elsewhere, joints(arm, rows, rng), rng, noise, see)
    return robot, train, measured(elsewhere, joints(arm, 60, rng), rng, noise, see)


@pytest.mark.parametrize("see", ["position", "markers"])
def test_distances_alone_calibrate_an_arm_as_well_as_positions(see: str) -> None:
    robot, train, held = campaign(see)
    relative = identify(robot, train, held, IdentifyOptions(base="removed"))
    absolute = identify(robot, train, held, IdentifyOptions(base="free"))
    block = relative.metrics["validation"]
    assert "x_mm" not in block["identified"]
    assert block["nominal"]["rms_mm"] > 1.0
    # A distance between two points has the noise of both along it.
    assert block["identified"]["rms_mm"] == pytest.approx(NOISE * np.sqrt(2.0) * 1e3, rel=0.15)
    assert relative.noise_m == pytest.approx(NOISE, rel=0.15)
    # And the identified arm, put where it fits, predicts positions it never saw as well as the absolute one.
    from kilter_core.evaluate import evaluate

    there = [evaluate(found.calibration, held, ("base",))["identified"]["rms_mm"] for found in (relative, absolute)]
    assert there[0] < 1.1 * there[1]


def test_the_base_has_no_parameters_and_stays_where_it_is() -> None:
    robot, train, _ = campaign(rows=60)
    found = identify(robot, train, None, IdentifyOptions(base="removed"))
    assert not [name for name in found.free_names if name.startswith("base_")]
    np.testing.assert_array_equal(found.calibration.model.T_base, robot.T_base)
    assert found.to_document()["reference"]["base"] == "robot"
    # Turning the first joint moves no distance: its zero cannot be told, and is said to be blind.
    assert any("theta_offset_1" in dict(d.weights) and d.structural for d in found.null_directions)


def test_a_fixed_base_is_believed_and_a_free_one_found() -> None:
    rng = np.random.default_rng(4)
    arm = ur10(base=some_pose(rng, 5.0))
    actual = arm.moved(table_errors(arm, rng))
    robot = robot_from_document(arm.document())
    train, held = (measured(actual, joints(arm, rows, rng), rng, NOISE) for rows in (120, 60))
    for base in ("fixed", "free", "removed"):
        found = identify(robot, train, held, IdentifyOptions(base=base))
        assert found.metrics["validation"]["identified"]["rms_mm"] < 0.06
        assert any(name.startswith("base_") for name in found.free_names) == (base == "free")
    # An instrument that does not stand where the robot says contradicts a base that is held.
    elsewhere = robot_from_document(ur10().document())
    with pytest.raises(OptionError, match="The base is held where the robot has it") as refused:
        identify(elsewhere, train, None, IdentifyOptions(base="fixed"))
    assert "--base free" in refused.value.message
    freed = identify(elsewhere, train, held, IdentifyOptions(base="free"))
    assert freed.metrics["validation"]["identified"]["rms_mm"] < 0.06


def test_residuals_and_slopes_are_those_of_the_distances() -> None:
    robot, train, _ = campaign("markers", rows=12)
    hidden = train.markers.copy()  # type: ignore[union-attr]
    hidden[3, 1] = np.nan
    measurement = Measurement.from_observations(Observations(train.q, markers=hidden), MARKERS, relative=True)
    pairs = Distances(measurement.observations, MARKERS).pairs
    model = RobotModel(robot)
    values = model.values0()
    prediction, J = model.jacobian(measurement.observations, values)
    residual = measurement.residual(prediction, J)
    factor = np.sqrt(2.0 * measurement.redundancy)
    points = prediction.position[:, None] + np.einsum("nij,mj->nmi", prediction.rotation, MARKERS)
    for (a, b), left in zip(pairs, residual.points[:, :, 0] * factor, strict=True):
        expected = np.linalg.norm(hidden[a] - hidden[b], axis=1) - np.linalg.norm(points[a] - points[b], axis=1)
        np.testing.assert_allclose(left, expected, atol=1e-12)
    k = model.names.index("alpha_2")
    sides = []
    for step in (1e-6, -1e-6):
        moved = values.copy()
        moved[k] += step
        sides.append(measurement.residual(model.predict(measurement.observations, moved)).points)
    slope = (sides[1] - sides[0]) / 2e-6
    seen = ~np.isnan(slope)
    assert 0 < np.count_nonzero(~seen) < 20
    np.testing.assert_allclose(residual.d_points[..., k][seen], slope[seen], atol=1e-6)  # type: ignore[index]


def test_folds_hold_out_poses_and_repeats_are_no_distances() -> None:
    robot, train, _ = campaign(rows=60)
    twice = Observations(np.repeat(train.q, 2, axis=0), position=np.repeat(train.position, 2, axis=0))  # type: ignore[arg-type]
    found = identify(robot, twice, Folds(4), IdentifyOptions(base="removed"))
    assert found.metrics["validation"]["identified"]["rms_mm"] < 0.1
    pairs = Distances(twice).pairs
    assert np.all(pairs[:, 0] // 2 != pairs[:, 1] // 2)


def test_what_goes_only_with_positions_is_refused() -> None:
    robot, train, _ = campaign(rows=30)
    for options in (
        IdentifyOptions(base="removed", method="kalman"),
        IdentifyOptions(base="removed", intervals="bootstrap"),
    ):
        with pytest.raises(OptionError, match="Distances between poses"):
            identify(robot, train, None, options)
    with pytest.raises(TooFewPosesError, match="five or more"):
        identify(robot, train.select(slice(0, 4)), None, IdentifyOptions(base="removed"))
    with pytest.raises(TooFewPosesError, match=r"at least 12 poses"):
        identify(robot, train.select(slice(0, 8)), None, IdentifyOptions(base="removed"))
    with pytest.raises(OptionError, match="removed"):
        IdentifyOptions(base="none")


def test_sigmas_tell_the_scatter_of_the_parameters() -> None:
    rng = np.random.default_rng(4)
    arm = ur10()
    actual = arm.moved(table_errors(arm, rng))
    robot, q = robot_from_document(arm.document()), joints(arm, 60, rng)
    values, sigmas = [], []
    for seed in range(12):
        rows = measured(actual, q, np.random.default_rng(seed), NOISE)
        found = identify(robot, rows, None, IdentifyOptions(base="removed"))
        known = [k for k, p in enumerate(found.to_document()["parameters"]) if p["identifiable"]]
        values.append(found.calibration.values[found.fit.problem.free])
        sigmas.append(found.fit.sigma)
    ratio = np.std(values, axis=0, ddof=1)[known] / np.mean(sigmas, axis=0)[known]
    assert len(known) > 10
    assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.4


@pytest.mark.parametrize("level", [1, 2, 3])
def test_every_level_goes_with_distances(level: int) -> None:
    twin = thesis_katana()
    low, high = twin.robot.limits.T
    rng = np.random.default_rng(0)
    train, held = (twin.observe(rng.uniform(low, high, (n, 5)), noise_m=1e-5, seed=n) for n in (118, 60))
    found = identify(twin.robot, train, held, IdentifyOptions(base="removed", level=level)).metrics["validation"]
    best = {1: 0.9, 2: 0.7, 3: 0.1}[level]  # share of the error as drawn, smaller with every level
    assert found["identified"]["rms_mm"] < best * found["nominal"]["rms_mm"]
