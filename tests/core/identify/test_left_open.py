"""What a fit to views leaves open and views that are held out hardly show: against where the arm really is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.evaluate import evaluate
from kilter_core.identify import IdentifyOptions, identify
from tests.core.measurement.test_pixels import STIFF, registered_error
from tests.core.pixel_scene import Scene, eye_to_hand, grid

ASKED = IdentifyOptions(masses="as_stated")


def far(seed: int) -> Scene:
    """A board of six corners, 8 cm wide, a metre and a half away; lengths are off by half a millimetre each."""
    rng = np.random.default_rng([7, seed])
    errors = {name: rng.normal(0.0, 5e-4) for name in ("a_2", "a_3", "d_4", "d_5")}
    scene = eye_to_hand({f"theta_offset_{j}": rng.normal(0.0, 3e-3) for j in range(2, 6)} | errors, STIFF)
    eye, sheet = scene.eyes[0], scene.sheets[0]
    ahead = eye.pose.rotation[:, 2]
    behind = replace(eye, pose=type(eye.pose)(eye.pose.rotation, eye.pose.translation - 0.5 * ahead))
    return replace(scene, eyes=(behind,), sheets=(replace(sheet, corners=grid(3, 2, 0.04)),))


def test_what_views_hardly_show_is_told_beside_what_they_show() -> None:
    """The cell may be larger than fitted by half a thousandth, and no corner moves across."""
    off, expected, shown, warned = [], [], [], 0
    for seed in range(5):
        scene, rng = far(seed), np.random.default_rng(seed)
        robot = robot_from_document(scene.drawn.document())
        rows = scene.observed(scene.poses(60, rng, fewest=6), rng, 0.3)
        found = identify(robot, rows, 0.25, ASKED)
        pixels = found.views["pixels"]
        off.append(1e3 * registered_error(found.calibration, scene, scene.poses(60, rng, fewest=6)))
        expected.append(pixels["left_open"]["rms_mm"])
        shown.append(pixels["validation"]["rms_mm"])
        warned += "views_tell_less" in {w["code"] for w in found.warnings}
        assert off[-1] < pixels["left_open"]["high_mm"]
        judged = evaluate(
            found.calibration, scene.observed(scene.poses(40, rng, fewest=6), rng, 0.3), (), found.predictive
        )
        assert judged["left_open"]["rms_mm"] == pytest.approx(expected[-1], rel=0.2)
        told = {w["code"]: w["message"] for w in judged["warnings"]}
        assert ("views_tell_less" in told) == (judged["left_open"]["rms_mm"] > 1.25 * judged["identified"]["rms_mm"])
    size = np.sqrt(np.mean(np.square(off)))
    assert 0.6 < size / np.sqrt(np.mean(np.square(expected))) < 1.5
    assert np.sqrt(np.mean(np.square(shown))) < 0.6 * size
    assert warned >= 2


def test_a_large_board_near_by_leaves_less_open_than_it_shows() -> None:
    scene, rng = eye_to_hand({"theta_offset_2": 2e-3}, STIFF), np.random.default_rng(1)
    rows = scene.observed(scene.poses(60, rng), rng, 0.1)
    found = identify(robot_from_document(scene.drawn.document()), rows, 0.25, ASKED)
    left, shown = found.views["pixels"]["left_open"], found.views["pixels"]["validation"]
    assert left["high_mm"] < 0.05
    assert left["rms_mm"] < 1.25 * shown["high_mm"]
    assert "views_tell_less" not in {w["code"] for w in found.warnings}


def test_a_version_that_views_refute_is_said_to_be_worse_than_none() -> None:
    scene, rng = eye_to_hand({"theta_offset_2": 2e-3}, STIFF), np.random.default_rng(3)
    rows = scene.observed(scene.poses(40, rng), rng, 0.1)
    found = identify(robot_from_document(scene.drawn.document()), rows, 0.25, ASKED)
    fine = evaluate(found.calibration, rows, (), found.predictive)["warnings"]
    assert {one["code"] for one in fine} <= {"views_tell_less"}
    values = found.calibration.values.copy()
    values[list(found.calibration.names).index("theta_offset_3")] += 0.01
    said, *_ = evaluate(replace(found.calibration, values=values), rows, (), found.predictive)["warnings"]
    assert said["code"] == "worse_than_without"
    assert said["identified_mm"] > 5.0 * said["simpler_mm"]
