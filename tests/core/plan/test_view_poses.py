"""Poses planned for cameras: boards whole in the picture, and an arm that is known better than from random views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects import make_effect
from kilter_core.errors import ObservationError, RobotError
from kilter_core.identify import identify
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.plan.views import placed_by_views, view_poses
from tests.core.measurement.test_pixels import ASKED, free, registered_error
from tests.core.pixel_scene import HOME, Scene, Sheet, drawn_pixels, eye_in_hand, eye_to_hand

Floats = NDArray[np.float64]
SPREAD = 0.9


def nominal(scene: Scene) -> Calibration:
    return Calibration.nominal(robot_from_document(scene.drawn.document()))


def started(scene: Scene, count: int = 12) -> tuple[Calibration, Observations]:
    """The nominal arm with its camera where a few first views say, and these views."""
    rng = np.random.default_rng(1)
    first = scene.observed(scene.poses(count, rng), rng)
    return placed_by_views(nominal(scene), first), first


def true(scene: Scene) -> Calibration:
    """The nominal arm with camera and board where they are."""
    poses = {0: scene.eyes[0].pose.homogeneous}, {0: scene.sheets[0].pose.homogeneous}
    return replace(nominal(scene), rig=PlacedRig.at_poses(scene.rig(), *poses))


def near(start: Calibration) -> Region:
    """The joints among which the random poses of a scene are."""
    return replace(Region.from_calibration(start), low=HOME - SPREAD, high=HOME + SPREAD)


def whole(scene: Scene, q: Floats) -> NDArray[np.bool_]:
    """Poses at which the camera sees the whole board, and not its back."""
    return np.asarray((~np.isnan(scene.pixels(q, scene.eyes[0], scene.sheets[0]))).all(axis=(1, 2)))


@pytest.mark.parametrize(
    "scene",
    [pytest.param(eye_to_hand(), id="to_hand"), pytest.param(eye_in_hand(), id="in_hand", marks=pytest.mark.slow)],
)
def test_20_planned_views_tell_more_than_20_random_ones(scene: Scene) -> None:
    """Held-out tool error by the covariance and as it is, over three draws of noise."""
    start, _ = started(scene)
    planned = view_poses(start, 20, region=near(start)).q
    assert whole(scene, planned).all()
    rest = scene.poses(200, np.random.default_rng(77))
    foretold: dict[str, list[float]] = {"planned": [], "random": []}
    off: dict[str, list[float]] = {"planned": [], "random": []}
    for seed in range(3):
        drawn = scene.poses(20, np.random.default_rng(50 + seed), fewest=48)
        for name, q in (("planned", planned), ("random", drawn)):
            result = identify(start.robot, scene.observed(q, np.random.default_rng(seed)), None, ASKED)
            widths = result.predictive.of_the_tool(result.calibration, Observations(rest))
            foretold[name].append(float(widths.mean()))
            off[name].append(registered_error(result.calibration, scene, rest))
    assert np.mean(foretold["planned"]) < 0.85 * np.mean(foretold["random"])
    assert np.mean(off["planned"]) < 0.85 * np.mean(off["random"])


def test_views_of_a_version_within_the_limits() -> None:
    """Unknown intrinsics and scale, an effect that needs a side: as an identification of them would have it."""
    scene = eye_to_hand()
    rng = np.random.default_rng(4)
    rows = scene.observed(scene.poses(40, rng), rng, rig=free(scene))
    version = identify(nominal(scene).robot, rows, None, ASKED).calibration
    plan = view_poses(
        version, 15, [make_effect("backlash").configure_for_robot(version.robot)], payloads_kg=(0.0, 5.0), seed=3
    )
    assert whole(scene, plan.q).all()
    low, high = version.robot.limits.T
    assert ((plan.q > low) & (plan.q < high)).all()
    assert np.ptp(plan.q, axis=0).max() > 2 * SPREAD
    assert plan.direction is not None
    assert plan.payload_kg is not None
    again = view_poses(
        version, 15, [make_effect("backlash").configure_for_robot(version.robot)], payloads_kg=(0.0, 5.0), seed=3
    )
    assert np.array_equal(again.q, plan.q)


def test_where_the_arm_was_driven_tells_on_which_side_a_board_is_printed() -> None:
    """The same sheet described with y up, so that its z points at whoever reads it."""
    seen = eye_to_hand()
    old = seen.sheets[0]
    over = pin.SE3(pin.exp3(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    scene = replace(seen, sheets=(Sheet(old.name, old.mount, old.pose * over, old.corners * [1.0, -1.0, 1.0]),))
    start, first = started(scene)
    assert whole(scene, view_poses(start, 10, driven=first.q).q).all()
    assert not whole(scene, view_poses(start, 10).q).any()


def test_of_a_cube_the_faces_towards_the_camera_count() -> None:
    side = np.array([[x, y, 0.03] for x in (-0.02, 0.0, 0.02) for y in (-0.02, 0.0, 0.02)])
    turns = [np.eye(3), *(pin.exp3(a * np.pi / 2 * np.eye(3)[k]) for a, k in ((1, 0), (2, 0), (3, 0), (1, 1), (3, 1)))]
    corners = np.concatenate([side @ R.T for R in turns])
    seen = eye_to_hand({}, np.zeros(6))
    scene = replace(seen, sheets=(replace(seen.sheets[0], corners=corners),))
    q = view_poses(true(scene), 12).q
    points = scene.in_camera(q, scene.eyes[0], scene.sheets[0]).reshape(len(q), 6, 9, 3)
    middles = points.mean(axis=2)
    outward = middles - middles.mean(axis=1, keepdims=True)
    cosine = -np.sum(outward * middles, axis=2) / np.linalg.norm(outward, axis=2) / np.linalg.norm(middles, axis=2)
    flat = drawn_pixels(points, scene.eyes[0].focal, scene.eyes[0].centre, scene.eyes[0].distortion)
    inside = ((flat > 0) & (flat < scene.eyes[0].size)).all(axis=3)
    assert ((inside & (cosine > 0.15)[..., None]).sum(axis=(1, 2)) >= 6).all()


def test_no_camera_and_no_pose_that_it_sees_are_refused() -> None:
    scene = eye_to_hand()
    with pytest.raises(ObservationError, match="a campaign of views") as refused:
        placed_by_views(nominal(scene), None)
    assert refused.value.code == "cameras_missing"
    with pytest.raises(ObservationError):
        view_poses(nominal(scene), 5)
    eye = scene.eyes[0]
    away = pin.SE3(pin.exp3(np.array([0.0, np.pi, 0.0])), np.array([0.0, 0.0, 3.0]))
    blind = true(replace(scene, eyes=(replace(eye, pose=eye.pose * away),)))
    with pytest.raises(RobotError, match="facing its camera"):
        view_poses(blind, 5, region=near(blind))
