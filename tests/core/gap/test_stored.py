"""What is stored of a hunt: the fit whose errors are reported, in frames to correct in, with the uncertainty of all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.noise.visits import average_visits
from kilter_core.identify import IdentifyOptions, Prior, identify
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana
from tests.core.gap.test_motions import QUICK as MOVING
from tests.core.gap.test_motions import motion
from tests.core.soft_arm import NOISE_M, scene

QUICK = GapOptions(resamples=10, permutations=5, bootstraps=499, next_poses=1)
SOFT = replace(QUICK, effects=("axial_compliance", "eccentricity", "encoder_scale", "backlash"))
HIDDEN = [("eccentricity", (1,), (9e-4, 5e-4)), ("backlash", (2,), (8e-4,)), ("eccentricity", (3,), (6e-4, 7e-4))]


def far_rows(seed=3, **sizes) -> Observations:
    """The soft arm's rows in SI."""
    made = scene(seed, **sizes)
    return Observations(
        q=made.q, position=made.measured, direction=made.direction, payload_kg=made.payload_kg, pose_id=made.pose
    )


@pytest.fixture(scope="module")
def ur10():
    return robot_from_document(scene(poses=2, again=1).drawn.document())


@pytest.fixture(scope="module")
def far(ur10):
    return find_gap(ur10, far_rows(), SOFT, validation=0)


@pytest.fixture(scope="module")
def fitted(ur10):
    return identify(ur10, far_rows(), options=IdentifyOptions(effects=("axial_compliance", "load_error")))


def left_mm(calibration: Calibration, rows: Observations) -> float:
    """Rms of the 3-D error that a stored calibration leaves at the visits."""
    document = Calibration.from_document(calibration.robot, calibration.to_document())
    residual = Measurement.from_observations(average_visits(rows).observations, document.marker_points).residual(
        document.predict(average_visits(rows).observations)
    )
    points = residual.points.reshape(-1, 3)
    return 1e3 * float(np.sqrt(np.nanmean(np.sum(points**2, axis=1))))


@pytest.mark.parametrize("measured", ["position", pytest.param("pose", marks=pytest.mark.slow)])
def test_the_stored_version_leaves_the_errors_that_are_reported(measured):
    robot, rows = katana(), campaign(katana(), HIDDEN, poses=100, seed=5, measured=measured)
    report = find_gap(robot, rows, QUICK, validation=0)
    assert "outliers" not in {w["code"] for w in report.warnings}
    assert [e.id for e in report.calibration.model.effects].count("eccentricity") == 1  # both joints in one
    assert {j.evidence.candidate.label for j in report.effects} == {"eccentricity j2", "backlash j3", "eccentricity j4"}
    assert left_mm(report.calibration, rows) == pytest.approx(report.gap["after_mm"], rel=1e-9)
    assert report.gap["after_mm"] < 0.5 * report.gap["before_mm"]
    more = campaign(robot, [*HIDDEN, ("encoder_scale", (0,), (4e-4,))], poses=100, seed=6, measured=measured)
    again = find_gap(robot, more, QUICK, start=report.calibration, validation=0)
    assert "outliers" not in {w["code"] for w in again.warnings}
    assert {e.id for e in again.calibration.model.effects} == {"eccentricity", "backlash", "encoder_scale"}
    assert left_mm(again.calibration, more) == pytest.approx(again.gap["after_mm"], rel=1e-9)


def test_a_hunt_works_in_the_frames_that_an_identification_finds(far, fitted):
    one, other = far.calibration, fitted.calibration
    assert far.to_document()["reference"] == fitted.to_document()["reference"] == {
        "base": "registration", "tool": "registration",
    }  # fmt: skip
    assert np.abs(one.wanted_base - other.wanted_base).max() < 1e-9
    assert np.abs(one.wanted_tool - other.wanted_tool).max() < 1e-9
    again = Calibration.from_document(one.robot, one.to_document())
    assert np.array_equal(again.wanted_base, one.wanted_base)


def test_a_hunt_from_a_version_keeps_its_frames_and_may_be_told_others(ur10, far):
    rows, quick = far_rows(seed=4), replace(SOFT, effects=("eccentricity",))
    kept = find_gap(ur10, rows, quick, start=far.calibration).calibration
    assert np.array_equal(kept.wanted_base, far.calibration.wanted_base)
    assert np.array_equal(kept.wanted_tool, far.calibration.wanted_tool)
    moved = replace(rows, position=rows.position + np.array([0.0, 0.0, 0.3]))
    anew = find_gap(ur10, moved, quick, start=far.calibration).calibration
    assert np.linalg.norm(anew.wanted_base[:3, 3] - kept.wanted_base[:3, 3]) == pytest.approx(0.3, abs=1e-3)
    own = find_gap(ur10, rows, replace(quick, reference="robot"), start=far.calibration).calibration
    assert np.array_equal(own.wanted_base, ur10.T_base)


def test_the_covariance_is_that_of_everything_that_was_fitted(far, fitted):
    found, model = far.stored.posterior, far.calibration.model
    places = [model.names.index(name) for name in found.names]
    assert places == sorted(places)
    # The whole family is named or its soft joints: either way their compliances are in it, with all of the geometry.
    both = [name for name in fitted.free_names if name in found.names]
    assert {"base_x", "tool_z", "a_2", "theta_offset_3", "compliance_2", "compliance_3"} <= set(both)
    assert set(fitted.free_names) - set(both) <= set(model.names) | {f"compliance_{j}" for j in (1, 4, 5, 6)}
    one = found.covariance[np.ix_(*[[found.names.index(n) for n in both]] * 2)]
    other = fitted.covariance[np.ix_(*[[fitted.free_names.index(n) for n in both]] * 2)]
    scale = np.sqrt(np.diag(other))
    assert np.all(np.linalg.eigvalsh(one / np.outer(scale, scale)) > 0.0)
    known = [k for k, n in enumerate(both) if n in ("a_2", "a_3", "theta_offset_3", "alpha_4", "d_5", "compliance_2")]
    assert np.all(np.abs(np.sqrt(np.diag(one))[known] / scale[known] - 1.0) < 0.35)
    k, m = both.index("a_2"), both.index("a_3")
    assert one[k, m] != 0.0


def test_a_hunt_says_what_the_distances_along_parallel_axes_are_together(far):
    """Joints 2 to 4 of the arm that measured are parallel: plain numpy drew it, and its three distances are of no matter
    one by one."""
    directions = far.to_document()["null_directions"]
    assert directions == far.stored.null_directions()
    (found,) = [one for own in directions for one in own["sums"] if one["parameters"][0]["name"] == "d_2"]
    assert {one["name"]: one["coefficient"] for one in found["parameters"]} == pytest.approx(
        {"d_2": 1.0, "d_3": 1.0, "d_4": 1.0}, abs=1e-3
    )
    true = 1e3 * sum(step.value for step in scene(3).built.steps if step.name in ("d_2", "d_3", "d_4"))
    assert abs(found["value"] - true) < 4.0 * found["sigma"] < 1.0


def test_a_filter_goes_on_from_a_hunt_with_a_few_more_poses(far, ur10):
    known = far.stored.covariance()
    prior = Prior(tuple(known["names"]), np.array(known["matrix"]))
    on = IdentifyOptions(method="kalman", noise_mm=1e3 * NOISE_M)
    found = identify(ur10, far_rows(seed=9, poses=4, again=1), options=on, start=far.calibration, prior=prior)
    assert found.free_names == far.stored.posterior.names
    assert np.array_equal(found.calibration.wanted_base, far.calibration.wanted_base)
    smaller = np.diag(found.covariance) / np.diag(far.stored.posterior.covariance)
    assert smaller.max() < 1.0 + 1e-9
    assert smaller.min() > 0.05  # a few poses more sharpen what the masses left open
    unseen = far_rows(seed=10)
    errors = unseen.position - found.calibration.predict(unseen).position
    assert np.sqrt(np.mean(errors**2)) < 1.3 * NOISE_M


def test_the_sigmas_of_effects_are_those_of_their_amplitudes(far):
    found = dict(zip(far.stored.posterior.names, far.stored.posterior.sigma, strict=True))
    amounts = [a for j in far.effects for a in j.evidence.amplitudes]
    assert amounts
    for a in amounts:
        assert found[far.library.parameters[a.column].name] == pytest.approx(a.sigma, rel=0.05)


def test_the_rows_are_those_of_an_identification(far, fitted):
    rows, other = far.stored.parameters(), fitted.to_document()["parameters"]
    assert {tuple(row) for row in rows} == {tuple(row) for row in other}
    assert [row["name"] for row in rows] == list(far.stored.posterior.names)
    one, two = ({row["name"]: row for row in table} for table in (rows, other))
    assert one["a_2"]["value"] == pytest.approx(two["a_2"]["value"], abs=6 * two["a_2"]["sigma"])
    assert one["a_2"]["nominal"] == pytest.approx(-612.0)
    assert one["a_2"]["identifiable"]
    assert one["base_x"]["value"] == pytest.approx(two["base_x"]["value"], abs=0.5)
    sentences = {d["sentence"] for d in far.stored.null_directions()}
    assert any("d_1" in s and "base_z" in s for s in sentences)


def test_the_noise_is_that_of_a_coordinate(far):
    assert far.gap["noise_mm"] == pytest.approx(1e3 * NOISE_M, rel=0.15)
    assert far.gap["noise_rms_mm"] == pytest.approx(1e3 * NOISE_M * np.sqrt(3), rel=0.15)
    assert far.gap["after_mm"] == pytest.approx(far.gap["noise_rms_mm"], rel=0.35)
    assert far.figures["gap_bar"][-1]["value"] == far.gap["noise_rms_mm"]
    assert far.noise["re_approach_mm"] == pytest.approx(1e3 * NOISE_M, rel=0.15)


@pytest.mark.parametrize("measured", ["pose", "markers"])
def test_the_noise_of_poses_and_markers_is_that_of_a_coordinate_too(measured):
    report = find_gap(katana(), campaign(katana(), seed=3, measured=measured), QUICK)
    assert report.gap["noise_mm"] == pytest.approx(2e-2, rel=0.2)
    assert report.noise["re_approach_mm"] == pytest.approx(2e-2, rel=0.2)
    if measured == "pose":  # orientation in degrees beside millimetres
        assert report.noise["covariance"][5][5] == pytest.approx(np.degrees(1e-4) ** 2, rel=0.5)


def test_stated_noise_is_said_as_it_was_stated():
    rows = campaign(katana(), seed=3)
    thrice = rows.select(np.repeat(np.arange(len(rows)), 3))  # three readings in each visit
    thrice = replace(thrice, t=None, position=thrice.position + 1e-6 * np.arange(len(thrice))[:, None] % 3)
    report = find_gap(katana(), thrice, replace(QUICK, noise_mm=0.02))
    assert report.gap["noise_mm"] == pytest.approx(0.02, rel=1e-6)


def test_joint_data_leave_the_arm_as_the_start_has_it(far, ur10):
    robot, rows = motion(0, 1e-4)
    start = identify(robot, campaign(robot, seed=8), options=IdentifyOptions(level=2)).calibration
    found = find_gap(robot, rows, MOVING, start=start)
    now = found.calibration
    assert "axial_compliance" in {e.id for e in now.model.effects}
    n = start.model.n_geometric
    assert np.array_equal(now.values[:n], start.values)
    for name in ("T_base", "T_tool"):
        assert np.array_equal(getattr(now.model, name), getattr(start.model, name))
    assert np.array_equal(now.wanted_base, start.wanted_base)
    assert np.array_equal(now.wanted_tool, start.wanted_tool)
    assert all(name.startswith("compliance") for name in found.stored.posterior.names)
    assert found.stored.metrics(rows, None, found.spikes) == {}


def test_joint_data_of_an_arm_as_drawn_set_the_zeros_of_its_joints():
    robot, rows = motion(0, 1e-4)
    found = find_gap(robot, rows, MOVING)
    zeros = {row["name"]: row for row in found.stored.parameters() if row["name"].startswith("theta_offset")}
    assert len(zeros) == robot.n_joints
    for row in zeros.values():
        assert row["value"] - row["nominal"] == pytest.approx(np.degrees(2e-4), abs=6 * row["sigma"])
        assert 0.0 < row["sigma"] < 0.01
        assert row["identifiable"]
    assert found.gap["noise_mm"] is None
    assert found.gap["noise_deg"] == pytest.approx(found.gap["noise_rms_deg"], rel=0.5)


def test_a_version_knows_how_noisy_a_coordinate_is_without_what_the_fit_took_of_it():
    """Its 95 % intervals were made of what is left of the rows searched: a tenth too small where poses are few."""
    quick = GapOptions(effects=("backlash",), resamples=1, permutations=1, bootstraps=199, next_poses=0)
    robot, noise = katana(), 2e-5
    told = []
    for seed in range(6):
        rows = campaign(robot, poses=42, revisits=0, seed=seed, noise_m=noise)
        report = find_gap(robot, rows, quick, validation=0)
        known = Predictive.from_document(report.stored.covariance())
        assert known is not None
        assert known.noise == 0.0  # nothing tells it from what the model lacks
        assert known.inadequacy == pytest.approx(report.gap["noise_mm"] * 1e-3, rel=1e-6)
        told.append(known.inadequacy / noise)
    assert np.mean(told) == pytest.approx(1.0, abs=0.06)


def test_noise_of_few_repeats_is_known_by_the_rows_that_agree_too():
    """Of a few poses visited thrice the noise is known to a fifth; the version tells it as well as all rows know it."""
    quick = GapOptions(effects=("backlash",), resamples=1, permutations=1, bootstraps=199, next_poses=0)
    alone, told = [], []
    for seed in range(6):
        report = find_gap(katana(), campaign(katana(), poses=60, revisits=5, seed=seed), quick, validation=0)
        document = report.stored.covariance()
        assert document["noise_of"] == "points"
        alone.append(report.gap["noise_mm"] / 0.02 - 1.0)
        told.append(float(np.hypot(document["noise_m"], document["inadequacy_m"])) / 2e-5 - 1.0)
    assert np.sqrt(np.mean(np.square(told))) < 0.6 * np.sqrt(np.mean(np.square(alone)))
