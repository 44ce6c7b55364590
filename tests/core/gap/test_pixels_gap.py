"""A gap search on views alone: a gear that yields is named, and a camera that was bumped half-way is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap.find import GapReport, find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.identify.seen_poses import as_seen_poses
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.pixel_scene import Scene, eye_in_hand, eye_to_hand

STIFF = np.zeros(6)
LOOKED_FOR = ("axial_compliance", "base_step", "tool_step", "backlash")


def search(scene: Scene, rows: Observations) -> GapReport:
    quick = GapOptions(permutations=3, resamples=10, bootstraps=199, effects=LOOKED_FOR, next_poses=0)
    return find_gap(robot_from_document(scene.drawn.document()), rows, quick)


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_views_are_poses_of_the_tool(scene: Scene) -> None:
    rng = np.random.default_rng(4)
    rows = scene.observed(scene.poses(30, rng), rng, 0.1)
    seen = as_seen_poses(Calibration.nominal(robot_from_document(scene.drawn.document())), rows)[0]
    off = seen.position - scene.tools(seen.q)[0]
    assert seen.pixels is None
    assert np.sqrt(np.mean((off / seen.sigma) ** 2)) < 2.0
    assert np.sqrt(np.mean((seen.rotation - scene.tools(seen.q)[1]) ** 2)) < 1e-3


def test_a_camera_bumped_half_way_is_found_and_not_averaged() -> None:
    scene = eye_to_hand(yielding=STIFF)
    rng = np.random.default_rng(1)
    q = scene.poses(60, rng)
    eye = scene.eyes[0]
    bump = pin.SE3(pin.exp3(np.array([0.0, 0.004, 0.0])), np.array([0.003, 0.0, 0.0]))
    bumped = replace(scene, eyes=(replace(eye, pose=eye.pose * bump),))
    halves = [scene.observed(q[:30], rng, 0.1), bumped.observed(q[30:], rng, 0.1)]
    rows = Observations.concatenate([replace(one, pose_id=None) for one in halves])
    report = search(scene, rows)
    assert report.effects[0].evidence.candidate.label == "base_step"
    assert report.effects[0].verdict in ("confirmed", "class_confirmed", "provisional")
