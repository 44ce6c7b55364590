"""Pixels through camera and chain, against an independent projector, OpenCV's and Pinocchio; and an arm fitted from them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.views import with_cameras
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.camera_model import project, undistort_pixels
from kilter_core.measurement.camera.rig_fit import solve_axzb
from kilter_core.measurement.camera.views import Views, equivalent_tool_motions, sight, sight_and_slopes, sight_by_tool
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.observations.rig import Board, Camera, Rig
from tests.core.pixel_scene import HOME, Scene, Sheet, eye_in_hand, eye_to_hand, grid, soft

Floats = NDArray[np.float64]
LENSES = {
    "none": (),
    "brown": (-0.21, 0.08, 0.0011, -0.0007, -0.02),
    "rational": (0.3, -0.1, 0.001, -0.0006, 0.02, 0.5, -0.08, 0.01),
    "fisheye": (0.03, -0.012, 0.004, -0.001),
}
STIFF = np.zeros(6)
ASKED = IdentifyOptions(effects=({"id": "axial_compliance", "joints": [2, 3]},), masses="as_stated")


def registered_error(found: Calibration, scene: Scene, q: Floats) -> float:
    """Mean distance m of the tool from the truth, the robot's base placed where that fits best."""
    a, b = found.predict(Observations(q)).position, scene.tools(q)[0]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return float(np.linalg.norm(b - a @ R.T, axis=1).mean())


@pytest.mark.parametrize("model", LENSES)
def test_pixels_are_those_of_opencv(model: str) -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (40, 2)), rng.uniform(0.8, 1.3, 40)])
    values = np.array([1300.0, 1310.0, 640.2, 479.7, *LENSES[model]])
    K = np.array([[1300.0, 0.0, 640.2], [0.0, 1310.0, 479.7], [0.0, 0.0, 1.0]])
    distortion = np.array(LENSES[model] or (0.0,) * 4)
    if model == "fisheye":
        theirs = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, distortion)[0]
    else:
        theirs = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, distortion)[0]
    seen = project(model, values, points)
    assert np.abs(seen.pixels - theirs.reshape(-1, 2)).max() < 1e-9
    assert np.abs(undistort_pixels(model, values, seen.pixels) - points[:, :2] / points[:, 2:]).max() < 1e-10


@pytest.mark.parametrize("model", LENSES)
def test_pixels_follow_points_and_intrinsics(model: str) -> None:
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (20, 2)), rng.uniform(0.8, 1.3, 20)])
    values = np.array([1300.0, 1310.0, 640.2, 479.7, *LENSES[model]])
    seen, h = project(model, values, points), 1e-6
    for k in range(3):
        step = h * np.eye(3)[k]
        slope = (project(model, values, points + step).pixels - project(model, values, points - step).pixels) / (2 * h)
        assert np.abs(seen.by_point[..., k] - slope).max() < 1e-4
    for k in range(len(values)):
        step = h * np.eye(len(values))[k]
        slope = (project(model, values + step, points).pixels - project(model, values - step, points).pixels) / (2 * h)
        assert np.abs(seen.by_intrinsics[..., k] - slope).max() < 1e-4


def free(scene: Scene) -> Rig:
    """Everything of cameras and boards unknown."""
    rig = scene.rig(cameras={"intrinsics": "free"})
    return replace(rig, boards=tuple(replace(b, scale_sigma=1e-3) for b in rig.boards))


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_a_right_model_leaves_nothing_and_its_jacobian_is_exact(scene: Scene) -> None:
    rng = np.random.default_rng(5)
    q = scene.poses(12, rng)
    rows = scene.observed(q, rng, 0.0, free(scene))
    robot = robot_from_document(scene.drawn.document())
    measurement = Measurement.from_observations(rows, held=True)
    model = with_cameras(Calibration.nominal(robot), rows, measurement)
    where = PlacedRig.at_poses(free(scene), {0: scene.eyes[0].pose.homogeneous}, {0: scene.sheets[0].pose.homogeneous})
    effect = replace(model.model.effects[-1], rig=where)
    right = Calibration(replace(model.model, effects=(effect,)), model.values.copy())
    right.values[right.model.n_geometric :] = where.values
    left = measurement.residual(right.predict(rows)).points / measurement.tool.metres_per_px
    assert np.nanmax(np.abs(left)) < 1e-8

    values = right.values + 1e-3 * rng.standard_normal(len(right.values))
    J = measurement.residual(*right.model.jacobian(rows, values)).d_points
    for k, name in enumerate(right.names):
        h = 1e-2 if name.endswith(("fx", "fy", "cx", "cy")) else 1e-6
        step = h * np.eye(len(values))[k]
        up, down = (measurement.residual(right.model.predict(rows, values + s * step)).points for s in (1, -1))
        slope = np.nan_to_num(down - up) / (2 * h)
        assert np.abs(np.nan_to_num(J[..., k]) * ~np.isnan(up) - slope).max() < 1e-6 * max(1.0, np.abs(slope).max()), (
            name
        )


def test_views_follow_the_unknowns_of_their_own_camera_and_board_alone() -> None:
    """One camera's lens is free, another's is not, and only one of two boards has a scale: each against differences."""
    one = eye_to_hand({}, STIFF)
    beside = replace(
        one.eyes[0], name="side", pose=pin.SE3(pin.exp3(np.array([0.0, 0.1, 0.0])), np.array([0.1, 0.0, 0.0]))
    )
    beside = replace(beside, pose=one.eyes[0].pose * beside.pose)
    other = replace(
        one.sheets[0],
        name="other",
        corners=grid(5, 4),
        pose=one.sheets[0].pose * pin.SE3(pin.exp3(np.zeros(3)), 0.01 * np.ones(3)),
    )
    scene = replace(one, eyes=(one.eyes[0], beside), sheets=(one.sheets[0], other))
    cameras = scene.eyes[0].described(intrinsics="free"), scene.eyes[1].described()
    rig = Rig(cameras, (scene.sheets[0].described(), scene.sheets[1].described(scale_sigma=1e-3)))
    eyes, sheets = ({k: part.pose.homogeneous for k, part in enumerate(of)} for of in (scene.eyes, scene.sheets))
    placed = PlacedRig.at_poses(rig, eyes, sheets)
    q = scene.poses(4, np.random.default_rng(3))
    camera, board = np.repeat([0, 0, 1, 1], 4), np.tile(np.repeat([0, 1], 4), 2)
    views = Views(camera, board, *(np.tile(part, (4, *(1,) * (part.ndim - 1))) for part in scene.tools(q)))
    pixels, slopes = sight_and_slopes(placed, views, 48)
    assert slopes.by_own.shape[3] == 10  # nine of the lens and the scale
    span, inner = slopes.low_rank_factors()
    whole = span @ inner[:, None]
    for k, parameter in enumerate(placed.parameters):
        h = 1e-2 if parameter.unit == "px" else 1e-6
        up, down = (
            sight(placed.with_values(placed.values + s * h * np.eye(len(placed.values))[k]), views, 48) for s in (1, -1)
        )
        slope = np.nan_to_num(up - down) / (2 * h)
        assert np.abs(whole[..., k] - slope).max() < 1e-6 * max(1.0, np.abs(slope).max()), parameter.name
    own = [k for k, (unknown, _) in enumerate(placed.unknowns) if unknown.what != "pose"]
    np.testing.assert_array_equal(slopes.by_unknown(np.arange(16)), whole[..., own])
    alone, by_tool = sight_by_tool(placed, views, 48)
    np.testing.assert_array_equal(alone, pixels)
    np.testing.assert_array_equal(by_tool, slopes.by_tool)
    np.testing.assert_array_equal(equivalent_tool_motions(placed, views), slopes.carried)


@pytest.mark.parametrize("scene", [eye_to_hand(), eye_in_hand()], ids=["to_hand", "in_hand"])
def test_pixels_alone_identify_the_arm(scene: Scene) -> None:
    rng = np.random.default_rng(6)
    rows = scene.observed(scene.poses(60, rng), rng, 0.1)
    result = identify(robot_from_document(scene.drawn.document()), rows, 0.25, ASKED)
    q = scene.poses(60, rng)
    before = registered_error(Calibration.nominal(result.calibration.robot), scene, q)
    assert before > 0.8e-3
    assert registered_error(result.calibration, scene, q) < 0.03e-3
    found = dict(zip(result.calibration.names, result.calibration.values, strict=True))
    assert found["compliance_2"] == pytest.approx(scene.yielding[1], rel=0.05)
    assert np.array_equal(result.calibration.model.T_base, result.calibration.robot.T_base)
    assert np.array_equal(result.calibration.model.T_tool, result.calibration.robot.T_tool)
    told = result.metrics["validation"]
    assert told["identified"]["mean_mm"] < 0.5 * told["registration_only"]["mean_mm"]
    again = Calibration.from_document(result.calibration.robot, result.calibration.to_document())
    unseen = Measurement.from_observations(rows, held=True)
    assert np.allclose(unseen.errors(again)[0], unseen.errors(result.calibration)[0], atol=1e-12)


def test_corner_sigmas_weigh_the_corners() -> None:
    scene = eye_to_hand({}, STIFF)
    rng = np.random.default_rng(7)
    rows = scene.observed(scene.poses(20, rng), rng, 0.1)
    sigma = np.where(np.arange(rows.pixels.shape[1]) % 2 == 0, 0.1, 20.0)[None, :, None] * np.ones_like(rows.pixels)
    rows = replace(rows, pixels=rows.pixels + np.where(sigma > 1.0, 20.0, 0.0) * rng.standard_normal(sigma.shape))
    robot = robot_from_document(scene.drawn.document())
    stated, plain = replace(rows, pixel_sigma=sigma), rows
    off = []
    for one in (stated, plain):
        rig = Measurement.from_observations(one, held=True).tool.fit_rig_to_rows(
            Calibration.nominal(robot).predict(one)
        )
        off.append(np.linalg.norm(rig.cameras[0].pose[:3, 3] - scene.eyes[0].pose.translation))
    assert off[0] < 0.3e-3 < off[1]


def test_the_closed_form_finds_camera_and_board() -> None:
    rng = np.random.default_rng(8)
    p, R = soft().poses(HOME + rng.uniform(-0.8, 0.8, (20, 6)))
    A, B = (pin.SE3.Random() for _ in range(2))
    M = [B.inverse() * pin.SE3(r, t) * A for r, t in zip(R, p, strict=True)]
    M_p, M_R = np.array([m.translation for m in M]), np.array([m.rotation for m in M])
    found = solve_axzb(p, R, M_p, M_R)
    assert np.abs(found.tool_side - A.homogeneous).max() < 1e-9
    assert np.abs(found.world_side - B.homogeneous).max() < 1e-9


def test_rotations_about_one_axis_are_refused() -> None:
    R = np.array([pin.exp3(np.array([0.0, 0.0, a])) for a in np.linspace(0.0, 1.0, 8)])
    with pytest.raises(ObservationError) as refused:
        solve_axzb(np.zeros((8, 3)), R, np.zeros((8, 3)), R)
    assert refused.value.code == "hand_eye_undetermined"


def test_a_camera_that_goes_with_its_board_is_refused() -> None:
    scene = eye_to_hand({}, STIFF)
    rng = np.random.default_rng(9)
    rows = scene.observed(scene.poses(5, rng), rng)
    both = replace(rows.rig, boards=tuple(replace(b, mount="fixed") for b in rows.rig.boards))
    with pytest.raises(ObservationError) as refused:
        Measurement.from_observations(replace(rows, rig=both), held=True)
    assert refused.value.code == "mounts_alike"


def test_several_cameras_and_a_solid_of_corners() -> None:
    """Two cameras and two boards, one of them a step in space: start values and bundle find all places."""
    one = eye_to_hand({}, STIFF)
    beside = pin.SE3(pin.exp3(np.array([0.0, 0.25, 0.1])), np.array([-0.25, 0.02, 0.05]))
    raised = grid(6, 5, 0.025) + np.array([0.0, 0.0, 0.02]) * (np.arange(30) % 3)[:, None]
    sheet = one.sheets[0]
    solid = Sheet("step", "flange", sheet.pose * pin.SE3(np.eye(3), np.array([0.02, 0.05, -0.03])), raised)
    scene = replace(
        one,
        eyes=(one.eyes[0], replace(one.eyes[0], name="side", pose=one.eyes[0].pose * beside)),
        sheets=(sheet, solid),
    )
    rng = np.random.default_rng(10)
    rows = scene.observed(scene.poses(25, rng), rng, 0.05)
    assert set(zip(rows.camera.tolist(), rows.board.tolist(), strict=True)) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    robot = robot_from_document(scene.drawn.document())
    rig = Measurement.from_observations(rows, held=True).tool.fit_rig_to_rows(Calibration.nominal(robot).predict(rows))
    for found, true in zip((*rig.cameras, *rig.boards), (*scene.eyes, *scene.sheets), strict=True):
        assert np.abs(found.pose - true.pose.homogeneous).max() < 5e-4, true.name


def test_campaigns_of_cameras_and_a_tracker_stand_side_by_side() -> None:
    scene = eye_to_hand()
    rng = np.random.default_rng(11)
    views = scene.observed(scene.poses(60, rng), rng, 0.3)
    q = HOME + rng.uniform(-1.2, 1.2, (12, 6))
    place = pin.SE3(pin.exp3(np.array([0.1, 0.2, 2.0])), np.array([2.0, 1.0, 0.3]))
    points = scene.tools(q)[0] @ place.rotation.T + place.translation + 1e-5 * rng.standard_normal((12, 3))
    both = Observations.concatenate([
        replace(views, pose_id=None), Observations(q, position=points)
    ])  # fmt: skip
    assert both.camera.tolist() == [*views.camera.tolist(), *[-1] * 12]
    robot = robot_from_document(scene.drawn.document())
    options = replace(ASKED, fix=("tool_*",))
    alone = identify(robot, replace(views, pose_id=None), None, ASKED)
    together = identify(robot, both, None, options)
    check = scene.poses(60, rng)
    assert registered_error(together.calibration, scene, check) < registered_error(alone.calibration, scene, check)
    kinds = [row["kind"] for row in together.to_document()["measurements"]]
    assert kinds == ["points", "pixels"]


def test_odd_cameras_are_refused_by_name() -> None:
    with pytest.raises(ObservationError, match="distortion has 3 numbers"):
        Camera("eye", "fixed", (640, 480), (600.0, 600.0), (320.0, 240.0), "brown", (0.1, 0.0, 0.0))
    with pytest.raises(ObservationError, match="too few"):
        Board("board", "flange", ((0.0, 0.0, 0.0),))
