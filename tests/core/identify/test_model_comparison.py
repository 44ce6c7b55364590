"""Versions that predict held-out poses worse than something simpler are said to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import Folds, Identification, IdentifyOptions, identify
from kilter_core.identify.comparison import MEAN, RMS, grown, worse_warning
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured, table_errors
from tests.core.gap.simulated import campaign, katana
from tests.core.truth import ur10, with_bodies

QUICK = GapOptions(resamples=20, permutations=5, bootstraps=499, next_poses=3)
WORSE = {"heldout_worse_than_registration", "worse_than_geometry"}
HARMONICS = IdentifyOptions(effects=("eccentricity", "second_harmonic", "encoder_scale"))


def codes(found: Any) -> set[str]:
    return {w["code"] for w in found.warnings}


def identified(poses: int, noise: float, options: IdentifyOptions, wrong: bool, folds: bool = False) -> Identification:
    rng = np.random.default_rng(4)
    arm = with_bodies(ur10(), rng)
    true = arm.moved(table_errors(arm, rng)) if wrong else arm
    train, held = (measured(true, joints(true, count, rng), rng, noise) for count in (poses, 100))
    return identify(robot_from_document(arm.document()), train, Folds(4) if folds else held, options)


def test_what_counts_as_worse() -> None:
    rng = np.random.default_rng(1)
    errors = rng.uniform(0.5, 1.5, 50)
    assert grown(errors, errors) is None
    assert grown(errors, 0.9 * errors) is None
    assert grown(errors, 1.02 * errors) is not None
    assert grown(errors, errors + rng.normal(0.0, 0.05, 50) - 0.02) is None
    one = grown(errors, np.where(np.arange(50) == 7, 5.0, 0.99 * errors))
    assert one is not None
    assert one.quantity == RMS
    assert one.after == pytest.approx(np.sqrt(np.mean(np.where(np.arange(50) == 7, 5.0, 0.99 * errors) ** 2)))


def test_what_is_compared_is_what_is_printed() -> None:
    """Most poses a little worse and a few much better: the mean grows while the rms falls, and the means are told."""
    before = np.where(np.arange(200) < 2, 0.2e-3, 0.05e-3)
    after = np.where(np.arange(200) < 2, 0.1e-3, 0.052e-3)
    assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2))
    told = grown(before, after)
    assert told is not None
    assert told.quantity == MEAN
    said = worse_warning("worse_than_geometry", "the geometry alone", told, beyond_chance=False)
    assert said["identified_mm"] == pytest.approx(1e3 * after.mean())
    assert said["identified_mm"] > said["simpler_mm"]
    assert "mean by pose" in said["message"]
    close = worse_warning("worse_than_geometry", "it", replace(told, before=5.2301e-5, after=5.2304e-5), False)
    assert "0.052304 mm" in close["message"]
    assert "0.052301 mm" in close["message"]


def test_twenty_poses_of_a_perfect_arm_are_worse_than_base_and_tool() -> None:
    found = identified(20, 5e-4, IdentifyOptions(), wrong=False)
    assert WORSE & codes(found) == {"heldout_worse_than_registration"}
    (said,) = [w for w in found.warnings if w["code"] == "heldout_worse_than_registration"]
    held = found.metrics["validation"]
    assert said["quantity"] == MEAN
    assert said["identified_mm"] == pytest.approx(held["identified"]["mean_mm"])
    assert said["simpler_mm"] == pytest.approx(held["registration_only"]["mean_mm"])
    assert "do not activate" in said["message"]


@pytest.mark.parametrize("folds", [False, True])
def test_effects_that_are_not_there_are_worse_than_geometry(folds: bool) -> None:
    assert "worse_than_geometry" in codes(identified(30, 5e-4, HARMONICS, wrong=True, folds=folds))


@pytest.mark.parametrize("folds", [False, True])
def test_the_geometry_alone_is_what_a_fit_without_effects_leaves(folds: bool) -> None:
    """The rigid arm beside the one with effects: its error on held-out poses is that of an identification of its own."""
    found, plain = (
        identified(30, 5e-4, options, wrong=True, folds=folds).metrics["validation"]
        for options in (HARMONICS, replace(HARMONICS, effects=()))
    )
    assert found["geometry_fitted"]["mean_mm"] == pytest.approx(plain["identified"]["mean_mm"], rel=1e-6)
    assert found["geometry_fitted"]["mean_mm"] != pytest.approx(found["identified"]["mean_mm"], rel=1e-3)
    assert "geometry_fitted" not in plain


def test_enough_poses_and_no_such_warning() -> None:
    assert not WORSE & codes(identified(150, 2e-5, IdentifyOptions(), wrong=True))
    one = replace(HARMONICS, effects=("eccentricity",))
    own = next(name for name in identified(150, 2e-5, one, wrong=True).free_names if "ecc" in name)
    # Patterns that name only the effect leave no geometry to compare with but base and tool.
    for free in (("a_*", own), (own,)):
        assert "worse_than_geometry" not in codes(identified(150, 2e-5, replace(one, free=free), wrong=True))


def test_a_hunt_whose_effect_is_gone_from_the_held_out_poses() -> None:
    robot = katana()
    train = campaign(robot, [("backlash", (1,), (2e-3,))])
    held = campaign(robot, seed=0)  # the same arm and poses, without play
    report = find_gap(robot, train, QUICK, validation=held)
    assert [(j.evidence.candidate.id, j.verdict) for j in report.effects] == [("backlash", "contradicted")]
    assert not WORSE & codes(report)  # the version does without it
    assert not report.calibration.model.effects
    again = find_gap(robot, train, QUICK, validation=0.25)
    assert not WORSE & codes(again)


@pytest.mark.parametrize("measured", ["position", pytest.param("markers", marks=pytest.mark.slow)])
def test_a_hunt_stores_what_an_identification_without_effects_leaves_beside_its_own(measured: str) -> None:
    """The rigid arm on the poses that the search never saw; and none where nothing was named, or nothing held out."""
    robot, backlash = katana(), [("backlash", (1,), (2e-3,))]
    rows = campaign(robot, backlash, poses=100, measured=measured)
    assert rows.pose_id is not None
    train, held = rows.select(rows.pose_id < 70), rows.select(rows.pose_id >= 70)
    report = find_gap(robot, train, QUICK, validation=held)
    assert [j.evidence.candidate.id for j in report.effects] == ["backlash"]
    found = report.stored.metrics(train, held, report.spikes)
    alone = identify(robot, train, held, IdentifyOptions(loss="huber")).metrics["validation"]["identified"]["mean_mm"]
    assert found["validation"]["geometry_fitted"]["mean_mm"] == pytest.approx(alone, rel=0.01)
    assert found["validation"]["geometry_fitted"]["mean_mm"] > 2.0 * found["validation"]["identified"]["mean_mm"]
    assert "geometry_fitted" not in found["train"]
    none = find_gap(robot, train, QUICK, validation=0).stored
    assert none.geometry is None
    clean = campaign(robot, poses=100)
    assert (
        find_gap(
            robot, clean.select(rows.pose_id < 70), QUICK, validation=clean.select(rows.pose_id >= 70)
        ).stored.geometry
        is None
    )


def test_a_hunt_says_which_effects_it_could_not_look_for_without_masses() -> None:
    robot = katana()
    light = replace(robot, links=tuple(replace(link, mass=0.0) for link in robot.links))
    rows = replace(campaign(robot), payload_kg=None)
    (said,) = [w for w in find_gap(light, rows, QUICK).warnings if w["code"] == "no_load"]
    assert "axial_compliance" in said["effects"]
    assert "mass_kg" in said["message"]
    assert "no_load" not in codes(find_gap(robot, rows, QUICK))


def test_copied_marker_columns_are_named() -> None:
    rng = np.random.default_rng(2)
    arm = ur10()
    robot = robot_from_document(arm.document())
    rows = measured(arm, joints(arm, 60, rng), rng, 2e-5, "markers")
    assert rows.markers is not None
    turn = arm.poses(rows.q)[1]
    extra = rows.markers[:, :1] + np.einsum("nij,j->ni", turn, [0.05, 0.07, -0.06])[:, None]
    whole = np.concatenate([rows.markers, extra], axis=1)
    assert "markers_equal" not in codes(identify(robot, replace(rows, markers=whole)))
    copied = np.concatenate([rows.markers, rows.markers[:, 1:2]], axis=1)
    (said,) = [w for w in identify(robot, replace(rows, markers=copied)).warnings if w["code"] == "markers_equal"]
    assert said["markers"] == [2, 4]
    with pytest.raises(ObservationError, match="Markers 1 and 2 are equal to the last digit"):
        identify(robot, Observations(rows.q, markers=rows.markers[:, [0, 0, 2]]))
