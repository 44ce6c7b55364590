"""The other methods of identification, on arms of Pinocchio and against batch solutions written here."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.errors import OptionError
from kilter_core.identify import Identification, IdentifyOptions, Prior, identify
from kilter_core.identify.fit.least_squares import Problem, Weights
from kilter_core.identify.measured_rows import parameter_influence
from kilter_core.identify.methods.kalman import run_kalman_filter
from kilter_core.identify.methods.per_pose import pose_solutions
from kilter_core.identify.registry import METHODS
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.plan.d_optimal import iso_poses
from kilter_core.twin import thesis_katana
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, small_pose, ur10

NOISE = 2e-5
FIXED = IdentifyOptions(base="fixed", tool="fixed")


def arms(seed: int, metres: float = 5e-4, radians: float = 1e-3) -> tuple[Robot, Arm, np.random.Generator]:
    rng = np.random.default_rng(seed)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    return robot_from_document(nominal.document()), nominal.moved(table_errors(nominal, rng, metres, radians)), rng


def rms(found: Identification) -> float:
    return float(found.metrics["validation"]["identified"]["rms_mm"] * 1e-3 / np.sqrt(3.0))


def test_every_method_has_an_estimator_and_a_section() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs/how-to/choose-a-method.md").read_text(encoding="utf-8")
    for method in METHODS:
        _, found, rest = page.partition(f"\n## `{method}`\n")
        assert found, method
        section = rest.partition("\n## ")[0]
        assert "**Use it**" in section, method
        assert "**Do not use it**" in section, method


@pytest.mark.parametrize("method", ["pose_pseudo_inverse", "influence"])
def test_exact_offsets_are_found_one_pose_at_a_time(method: str) -> None:
    """Where all poses agree the mean of their answers is the answer of least squares: the truth."""
    rng = np.random.default_rng(3)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    errors = {f"theta_offset_{j}": float(rng.normal(0.0, 2e-3)) for j in range(2, 7)}
    true = nominal.moved(errors)
    train, held = (measured(true, joints(true, n, rng), rng, 0.0, "pose") for n in (60, 40))
    options = replace(FIXED, level=1, method=method, fix=("theta_offset_1",))
    found = identify(robot_from_document(nominal.document()), train, held, options)
    assert rms(found) < 1e-6
    assert found.to_document()["method"]["name"] == method


def test_one_stacked_solve_is_numpy_s_on_a_jacobian_by_differences() -> None:
    """The stacked linear problem written here from the Pinocchio arm alone, priors as rows."""
    rng = np.random.default_rng(5)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    names = [f"theta_offset_{j}" for j in range(2, 7)] + ["a_2", "a_3", "alpha_1", "beta_2"]
    errors = {name: float(rng.normal(0.0, 3e-4)) for name in names}
    q = joints(nominal, 40, rng)
    rows = measured(nominal.moved(errors), q, rng, NOISE)
    assert rows.position is not None
    robot = robot_from_document(nominal.document())
    options = replace(FIXED, method="linear_least_squares", free=tuple(names), noise_mm=NOISE * 1e3)
    found = identify(robot, rows, options=options)
    h = 1e-6
    J = np.stack([
        (nominal.moved({n: h}).poses(q)[0] - nominal.moved({n: -h}).poses(q)[0]).reshape(-1) / (2 * h)
        for n in found.free_names
    ], axis=1)  # fmt: skip
    r = (rows.position - nominal.poses(q)[0]).reshape(-1)
    prior = np.array([found.calibration.model.parameter(n).prior_sigma for n in found.free_names])
    A = np.concatenate([J / NOISE, np.diag(1.0 / prior)])
    by_hand = np.linalg.lstsq(A, np.concatenate([r / NOISE, np.zeros(len(prior))]), rcond=None)[0]
    nominal_values = found.calibration.model.values0()
    place = [found.calibration.names.index(n) for n in found.free_names]
    np.testing.assert_allclose((found.calibration.values - nominal_values)[place], by_hand, rtol=2e-5, atol=1e-9)
    assert found.to_document()["method"]["linear_error"] < 0.2


def test_a_linear_solve_says_how_far_it_was_from_linear() -> None:
    robot, true, rng = arms(2, metres=5e-3, radians=2e-2)
    train, held = (measured(true, joints(true, n, rng), rng, NOISE) for n in (120, 60))
    linear = identify(robot, train, held, replace(FIXED, method="linear_least_squares", noise_mm=NOISE * 1e3))
    settled = identify(robot, train, held, replace(FIXED, noise_mm=NOISE * 1e3))
    assert linear.to_document()["method"]["linear_error"] > 10.0
    assert rms(linear) > 2.0 * rms(settled)


def test_a_pose_is_solved_as_the_weighted_pseudo_inverse() -> None:
    rng = np.random.default_rng(0)
    J, r, k = rng.normal(size=(5, 3, 9)), rng.normal(size=(5, 3)), rng.uniform(0.4, 1.0, (5, 9))
    plain = pose_solutions(J, r, np.ones((5, 9)), 1.0, 1e-12)
    weighted = pose_solutions(J, r, k, 0.5, 1e-12)
    for p in range(5):
        np.testing.assert_allclose(plain[p], np.linalg.pinv(J[p]) @ r[p], atol=1e-10)
        K = np.diag(k[p])
        np.testing.assert_allclose(weighted[p], K @ J[p].T @ np.linalg.inv(J[p] @ K @ J[p].T) @ r[p], atol=1e-9)


def test_one_pose_at_a_time_loses_to_all_poses_together() -> None:
    """Thesis table 3.4 has influence (0.21 mm) before the pseudo-inverse (0.38); on the twin both stay behind."""
    twin = thesis_katana()
    q = iso_poses(twin.robot, 178, seed=0)
    train, held = (twin.observe(part, noise_m=1e-5, seed=s) for s, part in enumerate((q[:118], q[118:])))
    left = {
        m: rms(identify(twin.robot, train, held, IdentifyOptions(level=2, method=m)))
        for m in ("least_squares", "pose_pseudo_inverse", "influence")
    }
    assert left["least_squares"] < left["influence"] < left["pose_pseudo_inverse"]


def test_influence_is_what_a_moved_arm_shows() -> None:
    robot, _, rng = arms(1)
    nominal = ur10(tool=small_pose(np.random.default_rng(1), 0.1, 0.3))
    q = joints(nominal, 20, rng)
    names = ("theta_offset_2", "alpha_4", "a_3", "d_1")
    found = parameter_influence(Calibration.nominal(robot), Observations(q), names)
    still = nominal.poses(q)[0]
    for c, name in enumerate(names):
        step = 1e-4 if name[0] in "ad" and name[1] == "_" else np.radians(0.05)
        moved = np.linalg.norm(nominal.moved({name: step}).poses(q)[0] - still, axis=1)
        np.testing.assert_allclose(found.moved[:, c], moved, atol=1e-12)
    assert np.all(found.relative.max(axis=1) == 1.0)
    lengths = found.moved[:, 2:]
    np.testing.assert_allclose(lengths, 1e-4, rtol=1e-9)  # thesis 3.5: 0.1 mm is 0.1 mm in every configuration
    rows = found.to_document()
    assert [row["mean_mm"] for row in rows] == sorted((row["mean_mm"] for row in rows), reverse=True)
    assert sum(row["leads"] for row in rows) == pytest.approx(1.0)


def test_the_filter_ends_where_the_stacked_solution_ends() -> None:
    robot, true, rng = arms(2)
    model = RobotModel(robot)
    measurement = Measurement.from_observations(measured(true, joints(true, 30, rng), rng, NOISE, "pose"))
    problem = Problem(model, measurement, np.arange(6, model.n_geometric - 6), Weights(NOISE, NOISE))
    values = model.values0()
    x, P, _ = run_kalman_filter(problem, values, problem.prior_mean, np.eye(len(problem.free)))
    near = problem.linearise(values)
    A = np.vstack([near.J * problem.prior_sigma, np.eye(len(x))])
    b = np.concatenate([near.r, np.zeros(len(x))])
    expected = np.linalg.lstsq(A, b, rcond=None)[0] * problem.prior_sigma + problem.prior_mean
    np.testing.assert_allclose(x, expected, atol=1e-9)
    np.testing.assert_allclose(P, np.linalg.inv(A.T @ A), atol=1e-9)


@cache
def growing() -> tuple[Robot, Observations, Observations, Observations]:
    robot, true, rng = arms(4)
    first, second, held = (measured(true, joints(true, n, rng), rng, NOISE, "pose") for n in (40, 40, 60))
    return robot, first, second, held


def test_kalman_is_least_squares() -> None:
    robot, first, _, held = growing()
    one, other = (identify(robot, first, held, replace(FIXED, method=m)) for m in ("kalman", "least_squares"))
    apart = (one.calibration.values - other.calibration.values)[one.fit.problem.free]
    assert np.max(np.abs(apart) / other.fit.sigma) < 0.02
    np.testing.assert_allclose(one.fit.sigma, other.fit.sigma, rtol=0.05)
    assert one.fit.report["mean_square_innovation"] == pytest.approx(1.0, abs=0.2)


def test_a_campaign_that_grows_needs_only_the_covariance_of_the_first() -> None:
    robot, first, second, held = growing()
    options = replace(FIXED, method="kalman", noise_mm=NOISE * 1e3)
    begun = identify(robot, first, held, options)
    prior = Prior(begun.free_names, begun.covariance)
    grown = identify(robot, second, held, options, begun.calibration, prior=prior)
    whole = identify(robot, Observations.concatenate([first, second]), held, options)
    apart = (grown.calibration.values - whole.calibration.values)[grown.fit.problem.free]
    assert np.max(np.abs(apart) / whole.fit.sigma) < 0.3
    assert np.all(grown.fit.sigma < begun.fit.sigma)
    np.testing.assert_allclose(grown.fit.sigma, whole.fit.sigma, rtol=0.1)
    few = identify(robot, second.select(slice(0, 2)), held, options, begun.calibration, prior=prior)
    assert rms(few) < 1.1 * rms(begun)  # two poses are welcome where a batch refuses them
    assert len(few.null_directions) == len(
        whole.null_directions
    )  # what two poses alone do not see is known from before


def test_a_covariance_of_another_size_is_refused() -> None:
    robot, first, _, _ = growing()
    with pytest.raises(OptionError, match="covariance"):
        identify(robot, first, None, replace(FIXED, method="kalman"), prior=Prior(("a_2",), np.eye(2)))


def test_gross_errors_are_found_by_the_search() -> None:
    rng = np.random.default_rng(5)
    nominal = ur10()
    names = [s.name for s in nominal.steps if s.name]
    errors = {
        s.name: float(rng.uniform(-1, 1)) * (np.radians(5.0) if s.axis[0] == "r" else 0.02)
        for s in nominal.steps
        if s.name in names
    }
    true = nominal.moved(errors)
    train, held = (measured(true, joints(true, n, rng), rng, NOISE) for n in (80, 60))
    found = identify(robot_from_document(nominal.document()), train, held, IdentifyOptions(method="global_search"))
    assert found.metrics["validation"]["registration_only"]["mean_mm"] > 5.0
    assert rms(found) == pytest.approx(NOISE, rel=0.35)
    assert found.fit.report["best_mm"] < found.fit.report["start_mm"]


def test_a_search_without_chain_parameters_is_refused() -> None:
    robot, first, _, _ = growing()
    with pytest.raises(OptionError, match="chain parameter"):
        identify(robot, first, None, IdentifyOptions(method="global_search", free=("base_*",), tool="fixed"))
    with pytest.raises(OptionError, match="search_mm"):
        IdentifyOptions(search_mm=0.0)


def test_tilt_first_holds_what_the_start_knows_and_fits_what_it_does_not() -> None:
    twin = thesis_katana()
    q = iso_poses(twin.robot, 178, seed=0)
    train, held = (twin.observe(part, noise_m=1e-5, seed=s) for s, part in enumerate((q[:118], q[118:])))
    options = IdentifyOptions(level=3, tilt_first=True)
    start = Calibration.nominal(twin.robot).with_effects(twin.effects)
    n = start.model.n_geometric
    start.values[n:] = twin.truth.values[n:]
    known = identify(twin.robot, train, held, options, start)
    fitted = identify(twin.robot, train, held, options)
    np.testing.assert_array_equal(known.calibration.values[n:], twin.truth.values[n:])
    assert (known.fit.report["effects"], fitted.fit.report["effects"]) == ("held", "fitted first")
    together = identify(twin.robot, train, held, IdentifyOptions(level=3))
    assert rms(known) <= 1.1 * rms(together) < 0.5 * rms(fitted)
    assert rms(fitted) < 0.2 * rms(identify(twin.robot, train, held, IdentifyOptions(level=2)))


@pytest.mark.parametrize("rows", [60, 1200])
def test_every_identification_says_how_far_its_parameters_move_the_tool(rows: int) -> None:
    twin = thesis_katana()
    q = np.random.default_rng(4).uniform(*twin.robot.limits.T, (rows, 5))
    seen = twin.observe(q, noise_m=1e-5)
    found = identify(twin.robot, seen, None, IdentifyOptions())
    asked = parameter_influence(found.calibration, seen, found.fit.names).to_document()
    assert found.influence is not None
    means = {row["name"]: row["mean_mm"] for row in found.influence}
    assert means.keys() == {row["name"] for row in asked}
    for row in asked:  # of a sample of many rows, nearly what all say
        assert means[row["name"]] == pytest.approx(row["mean_mm"], rel=1e-12 if rows <= 500 else 0.1)
