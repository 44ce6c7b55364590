"""A fit that leaves more than the stated noise: how much, in which rows, and intervals that hold the truth again.

The arm, its loads and what they do are the blind generator's; its links are 10 % heavier or lighter than stated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.uncertainty.clustered import with_clustered_covariance
from kilter_core.observations import Observations
from tests.core.off_zero import OffZero, soft_elbow

NOISE_M = 2e-5
TRUTH = {
    "clearance_tilt": ((0, 1, 2, 3, 4), (4e-4,) * 5),
    "backlash_load": ((1, 2, 3, 4), (6e-4, 5e-4, 8e-4, 8e-4)),
}
NAMED = tuple({"id": name, "joints": [j + 1 for j in joints]} for name, (joints, _) in TRUTH.items())
STEMS = {"clearance_tilt": "clearance", "backlash_load": "backlash_load"}
EXACT = IdentifyOptions(effects=NAMED, masses="as_stated")


@pytest.fixture(scope="module")
def twin() -> OffZero:
    return soft_elbow(**TRUTH)


def stated(twin: OffZero, seed: int, noise_m: float = NOISE_M) -> Observations:
    """Rows that say their noise, without repeats."""
    rows = twin.rows(80, seed, noise_m)
    once = rows.select(np.unique(rows.pose_id, return_index=True)[1])
    return replace(once, sigma=np.full((len(once), 3), NOISE_M), pose_id=None)


def misstated(twin: OffZero, seed: int):
    """The robot with masses that are 10 % wrong."""
    off = 1.0 + 0.1 * np.random.default_rng(seed).standard_normal(len(twin.drawn.mass))
    return robot_from_document(twin.drawn.document(np.asarray(twin.drawn.mass) * off))


def said(found: Identification) -> list[dict]:
    return [w for w in found.to_document()["warnings"] if w["code"] == "more_than_stated_noise"]


def apart(found: Identification) -> np.ndarray:
    """Errors of the amplitudes, in their sigmas."""
    values = dict(zip(found.free_names, found.fit.values[found.fit.problem.free], strict=True))
    sigma = dict(zip(found.free_names, found.fit.sigma, strict=True))
    return np.array([
        (values[f"{STEMS[name]}_{j + 1}"] - true) / sigma[f"{STEMS[name]}_{j + 1}"]
        for name, (joints, truth) in TRUTH.items() for j, true in zip(joints, truth, strict=True)
    ])  # fmt: skip


@pytest.fixture(scope="module")
def wrong(twin: OffZero) -> list[tuple[Observations, Identification]]:
    made = [(stated(twin, seed), misstated(twin, seed)) for seed in range(1, 9)]
    return [(rows, identify(robot, rows, options=EXACT)) for rows, robot in made]


def test_it_says_by_how_much_and_in_which_rows(twin: OffZero, wrong) -> None:
    for rows, found in wrong:
        (warning,) = said(found)
        left = rows.position - found.calibration.predict(rows).position
        freedom = left.size - len(found.free_names)
        assert warning["stated_mm"] == pytest.approx(NOISE_M * 1e3)
        assert warning["factor"] == pytest.approx(np.sqrt(np.sum(left**2) / freedom) / NOISE_M, rel=0.1)
        size = np.linalg.norm(left, axis=1)
        assert warning["rows"] == (np.argsort(-size)[: len(warning["rows"])] + 1).tolist()
        assert set(warning["near_sign_change"]) <= set(warning["rows"])
        assert 'masses as "uncertain"' in warning["message"]


def test_rows_near_a_change_of_sign_leave_the_most(wrong) -> None:
    """Among the rows named they are more frequent than among all: the twins' only error is that of the masses."""
    named = [len(said(found)[0]["near_sign_change"]) / len(said(found)[0]["rows"]) for _, found in wrong]
    usual = [found.beyond.usual for _, found in wrong]
    assert np.mean(named) > 1.5 * np.mean(usual)


def test_intervals_are_widened_by_what_is_left(wrong) -> None:
    z = np.abs([apart(found) for _, found in wrong])
    before = z * np.array([[found.beyond.widening] for _, found in wrong])
    assert np.mean(before > 1.96) > 0.15
    assert np.mean(z > 1.96) < 0.5 * np.mean(before > 1.96)


def test_right_masses_end_it(twin: OffZero) -> None:
    rows = stated(twin, 1)
    assert not said(identify(twin.robot, rows, options=EXACT))


def test_rows_held_out_keep_the_numbers_of_those_given(twin: OffZero) -> None:
    rows = stated(twin, 2)
    found = identify(misstated(twin, 2), rows, 0.25, options=EXACT)
    (warning,) = said(found)
    assert found.inside is not None
    assert set(np.array(warning["rows"]) - 1) <= set(found.inside.tolist())
    left = np.linalg.norm(rows.position - found.calibration.predict(rows).position, axis=1)
    assert warning["rows"][0] - 1 == found.inside[np.argmax(left[found.inside])]


def test_without_signs_it_is_said_and_nothing_is_widened(twin: OffZero) -> None:
    """The scatter of the poses is in the covariance already."""
    found = identify(twin.robot, stated(twin, 3), options=IdentifyOptions())
    (warning,) = said(found)
    assert warning["widened_by"] == 1.0
    assert "kilter gap" in warning["message"]
    np.testing.assert_allclose(found.covariance, with_clustered_covariance(found.fit).covariance, rtol=1e-9)


def test_an_arm_that_leaves_its_noise_is_not_accused() -> None:
    rigid = soft_elbow()
    for seed in range(4):
        assert not said(identify(rigid.robot, stated(rigid, seed), options=IdentifyOptions()))


def test_noise_that_repeats_show_is_not_the_models(twin: OffZero) -> None:
    """Rows scatter five times as much as stated: repeats tell, so the model is not blamed."""
    rigid = soft_elbow()
    rows = rigid.rows(80, 1, 5.0 * NOISE_M)
    told = replace(rows, sigma=np.full((len(rows), 3), NOISE_M))
    assert not said(identify(rigid.robot, told, options=IdentifyOptions()))
    alone = stated(rigid, 1, 5.0 * NOISE_M)
    (warning,) = said(identify(rigid.robot, alone, options=IdentifyOptions()))
    assert warning["factor"] == pytest.approx(5.0, rel=0.15)
    assert "repeat poses" in warning["message"]
