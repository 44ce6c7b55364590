"""A check by views: quiet where the arm is as it was, loud where a joint moved, refused for a camera it does not know.

A version that was made by views judges a tracker's rows by their own noise, and is re-zeroed by views.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f, kstest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, OptionError
from kilter_core.evaluate import evaluate
from kilter_core.evaluate.error_budget import Budget
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.estimate import refit_frames
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.observations import Observations
from kilter_core.watch import check, rezero
from tests.core.pixel_scene import eye_to_hand

SCENE = eye_to_hand(yielding=np.zeros(6))


@pytest.fixture(scope="module")
def made() -> Identification:
    """The arm by 60 views, its tilting too."""
    rng = np.random.default_rng(0)
    rows = SCENE.observed(SCENE.poses(60, rng), rng, 0.1)
    return identify(robot_from_document(SCENE.drawn.document()), rows, None, IdentifyOptions())


def test_a_joint_that_moved_is_seen_by_the_camera(made: Identification) -> None:
    rng = np.random.default_rng(1)
    fresh = SCENE.poses(10, rng)
    still = check(made.calibration, SCENE.observed(fresh, rng, 0.1), made.predictive)
    assert still.verdict == "ok"
    crashed = fresh + np.array([0.0, 0.0, np.radians(0.3), 0.0, 0.0, 0.0])
    moved = replace(SCENE.observed(crashed, rng, 0.1), q=fresh, pose_id=None)
    found = check(made.calibration, moved, made.predictive)
    assert found.verdict in ("moved", "cannot_tell")
    assert found.p_value < 1e-6
    other = replace(moved, rig=replace(moved.rig, cameras=(replace(moved.rig.cameras[0], name="other"),)))
    with pytest.raises(ObservationError) as refused:
        check(made.calibration, other, made.predictive)
    assert refused.value.code == "camera_unknown"


def test_a_check_by_views_takes_each_view_as_certain_as_its_corners_make_it() -> None:
    """Of arms that have not moved the chance is uniform over 150 checks; 0.1 degrees of one joint are found in each."""
    robot, chances, alarms, found = robot_from_document(SCENE.drawn.document()), [], [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        rows = SCENE.observed(SCENE.poses(40, rng), rng, 0.1)
        made = identify(robot, rows, None, IdentifyOptions(fix=("beta_*",)))
        for _ in range(6):
            still = check(made.calibration, SCENE.observed(SCENE.poses(8, rng), rng, 0.1), made.predictive)
            chances.append(f.sf(still.chi_square / still.numbers, still.numbers, made.predictive.freedom))
            alarms.append(still.p_value)
        fresh, turned = SCENE.poses(8, rng, fewest=36), np.radians(0.1) * np.eye(6)[2]
        seen = SCENE.observed(fresh + turned, rng, 0.1)
        crashed = check(made.calibration, replace(seen, q=fresh[seen.pose_id], pose_id=None), made.predictive)
        found.append(crashed.verdict == "moved" and crashed.causes[0].cause.name == "zero_3")
    # Six checks share the errors of a version, which are a tenth of their variance: some 100 independent ones.
    assert kstest(chances, "uniform").pvalue > 0.01, np.quantile(chances, [0.05, 0.25, 0.5, 0.75, 0.95])
    assert np.sum(np.array(alarms) <= 1e-3) <= 1  # of 150 with a chance of 0.001 each more than one has 1 %
    assert np.sum(np.array(alarms) < 0.05) <= 14  # of 150 with a chance of 0.05 at most, more have 1 %
    assert np.quantile(alarms, 0.2) < 0.6  # and is not always one
    assert np.mean(found) == 1.0


def test_what_only_camera_and_arm_together_know_does_not_blur_a_check() -> None:
    """Some numbers of the arm are known with the board's place only: where an arm is, as a camera sees it, is known as well as
    the views of its fit leave it. 28 numbers by 100 views make a check of 8 views 2.2 deviations² uncertain, of its 48.
    """
    rng = np.random.default_rng(501)
    rows = SCENE.observed(SCENE.poses(100, rng), rng, 0.1)
    made = identify(robot_from_document(SCENE.drawn.document()), rows, None, IdentifyOptions(fix=("beta_*",)))
    fresh = SCENE.observed(SCENE.poses(8, rng), rng, 0.1)
    certain = replace(made.predictive, covariance=1e-8 * made.predictive.covariance)
    known, alone = (check(made.calibration, fresh, one).chi_square for one in (made.predictive, certain))
    assert alone - known < 6.0  # at most 3 times that many; 31 were lost to directions that no view shows


def test_a_stated_noise_takes_views_as_places() -> None:
    rng = np.random.default_rng(4)
    rows = SCENE.observed(SCENE.poses(40, rng), rng, 0.1)
    made = identify(robot_from_document(SCENE.drawn.document()), rows, None, IdentifyOptions(fix=("beta_*",)))
    fresh = SCENE.observed(SCENE.poses(8, rng), rng, 0.1)
    own, stated = (check(made.calibration, fresh, made.predictive, noise=noise) for noise in (None, 5e-4))
    assert (own.numbers, stated.numbers) == (6 * 8, 3 * 8)
    assert stated.noise == 5e-4
    assert own.noise < 2e-4
    assert (own.by_views, stated.by_views) == (True, False)  # which lengths they are


def test_a_version_by_views_judges_a_tracker_by_its_own_noise(made: Identification) -> None:
    rng = np.random.default_rng(2)
    assert made.predictive.noise_of == "pixels"
    known = Predictive.from_document(made.predictive.to_document())
    assert known is not None
    tracker = 5e-6
    q = np.tile(SCENE.poses(20, rng), (2, 1))
    twice = Observations(q, position=SCENE.tools(q)[0] + tracker * rng.standard_normal((40, 3)))
    measurement = Measurement.from_observations(twice, held=True)
    at = refit_frames(made.calibration, measurement, ("base", "tool"))
    budget = Budget.from_measurement(at, known, measurement, None, ("base", "tool"))
    assert budget is not None
    assert np.sqrt(budget.variances["repeatability"].mean()) == pytest.approx(tracker, rel=0.3)
    assert (
        2e3 * np.sqrt(np.mean(budget.measured_error_uncertainty**2)) < 0.02
    )  # mm; a corner is 0.1 mm wide, which no tracker is
    once = replace(twice, q=twice.q[:20], position=twice.position[:20])
    lacking = Budget.from_measurement(at, known, Measurement.from_observations(once, held=True), None, ("base", "tool"))
    assert lacking is not None
    assert "repeatability" in lacking.to_document()["not_assessed"]
    assert evaluate(at, once, [], known)["within_u95"] is None
    stated = replace(once, sigma=np.full((20, 3), tracker))
    assert evaluate(at, stated, ["base", "tool"], known)["within_u95"] > 0.85
    with pytest.raises(OptionError, match="state the noise"):
        check(made.calibration, once, known, new_setup=["base", "tool"])
    assert check(made.calibration, twice, known, new_setup=["base", "tool"]).noise == pytest.approx(tracker, rel=0.3)


def test_a_joint_is_rezeroed_by_views(made: Identification) -> None:
    rng = np.random.default_rng(3)
    fresh, moved = SCENE.poses(12, rng), np.radians(0.2)
    crashed = fresh + moved * np.eye(6)[2]
    seen = replace(SCENE.observed(crashed, rng, 0.1), q=fresh, pose_id=None)
    found = rezero(made.calibration, seen, made.predictive)
    assert [one.name for one in found.causes] == ["zero_3"]
    assert abs(found.change[0] - moved) < 3.0 * found.sigma[0] < 0.1 * moved
    assert found.after.verdict == "ok"
    later = SCENE.poses(10, rng)
    again = replace(SCENE.observed(later + moved * np.eye(6)[2], rng, 0.1), q=later, pose_id=None)
    assert check(found.calibration, again, found.known).verdict == "ok"
    assert check(made.calibration, again, made.predictive).verdict != "ok"
