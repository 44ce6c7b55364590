"""Hand-eye calibration from flange poses: on a scene with known truth, and on real pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from kilter_core.errors import ObservationError
from kilter_core.observations.rig import Board, Camera, Rig
from kilter_core.procedures.reference_frame import hand_eye
from tests.core.pixel_scene import eye_in_hand, eye_to_hand

STIFF = np.zeros(6)


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_camera_and_board_are_found_within_their_sigmas(scene) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(2)
    rows = scene.observed(scene.poses(25, rng), rng, 0.1)
    p, R = scene.tools(rows.q)
    found = hand_eye(p, R, rows.rig, rows.pixels)
    sigma = np.sqrt(np.diag(found.covariance))
    for place, true, s in zip(
        (*found.rig.cameras, *found.rig.boards), (*scene.eyes, *scene.sheets), (0, 6), strict=True
    ):
        off = np.linalg.norm(place.pose[:3, 3] - true.pose.translation)
        assert off < 4.0 * np.linalg.norm(sigma[s : s + 3])
    assert found.scatter.sigma_px == pytest.approx(0.1, rel=0.1)
    assert found.scatter.place_low < 2e-5
    # The bundle is nearer than the closed form, which trusts the pose of each view.
    off = [
        np.linalg.norm(one.cameras[0].pose[:3, 3] - scene.eyes[0].pose.translation)
        for one in (found.closed_form, found.rig)
    ]
    assert off[1] < off[0]


def test_an_arm_that_is_off_shows_in_what_views_scatter_by() -> None:
    scene = eye_to_hand()
    rng = np.random.default_rng(3)
    rows = scene.observed(scene.poses(25, rng), rng, 0.1)
    p, R = scene.drawn.poses(rows.q)
    found = hand_eye(p, R, rows.rig, rows.pixels)
    assert found.scatter.beyond > 10.0
    assert found.scatter.place_low > 1e-4


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_an_arm_that_is_off_is_told_and_costs_no_more_than_it_must(scene) -> None:  # type: ignore[no-untyped-def]
    """1 mm and 1 mrad in each pose. Weighed by its corners alone each view put the camera 2.5 times as far off as AX = ZB."""
    off, told, by_closed_form, place = [], [], [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rows = scene.observed(scene.poses(20, rng), rng, 0.1)
        p, R = scene.tools(rows.q)
        R = R @ Rotation.from_rotvec(1e-3 * rng.standard_normal(p.shape)).as_matrix()
        found = hand_eye(p + 1e-3 * rng.standard_normal(p.shape), R, rows.rig, rows.pixels)
        true = scene.eyes[0].pose.translation
        off.append(found.rig.cameras[0].pose[:3, 3] - true)
        by_closed_form.append(found.closed_form.cameras[0].pose[:3, 3] - true)
        told.append(np.trace(found.covariance[:3, :3]))
        place.append(found.scatter.place)
    size = np.sqrt(np.mean(np.sum(np.square(off), axis=1)))
    assert size < 1.05 * np.sqrt(np.mean(np.sum(np.square(by_closed_form), axis=1)))
    assert size == pytest.approx(np.sqrt(np.mean(told)), rel=0.4)
    assert np.mean(place) == pytest.approx(1e-3, rel=0.15)


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
@pytest.mark.parametrize("off_m", [0.0, 1e-4])
def test_what_the_flange_is_off_by_is_told_by_the_corners_that_tell_it(scene, off_m: float) -> None:  # type: ignore[no-untyped-def]
    """Every other corner is ten times as noisy, and says so. Counted alike, they told 0.04 mm of an arm that is exact."""
    place = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rows = scene.observed(scene.poses(20, rng), rng, 0.0)
        sigma = np.full(rows.pixels.shape, 0.1)
        sigma[:, ::2] = 1.0
        p, R = scene.tools(rows.q)
        p, turn = p + off_m * rng.standard_normal(p.shape), off_m * rng.standard_normal(p.shape)
        pixels = rows.pixels + sigma * rng.standard_normal(sigma.shape)
        found = hand_eye(p, R @ Rotation.from_rotvec(turn).as_matrix(), rows.rig, pixels, sigma=sigma)
        place.append(found.scatter.place)
    assert np.mean(place) == pytest.approx(off_m, rel=0.3, abs=1e-5)


def test_views_without_corners_are_refused() -> None:
    scene = eye_to_hand({}, STIFF)
    rng = np.random.default_rng(4)
    rows = scene.observed(scene.poses(5, rng), rng, 0.1)
    with pytest.raises(ObservationError) as refused:
        hand_eye(*scene.tools(rows.q), rows.rig, np.full_like(rows.pixels, np.nan))
    assert refused.value.code == "no_view"


def test_real_pictures_of_an_industrial_arm(shared_data: Path) -> None:
    """16 pictures with flange poses: camera and board near those published, half a pixel left, millimetres of the arm."""
    folder = shared_data / "charuco-industrial"
    known = yaml.safe_load((folder / "cal_data.yaml").read_text())
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    layout = cv2.aruco.CharucoBoard((5, 7), 0.036195, 0.018256, dictionary)
    detector = cv2.aruco.CharucoDetector(layout)
    corners = np.asarray(layout.getChessboardCorners(), dtype=np.float64)
    pixels, p, R = [], [], []
    for k in range(16):
        picture = cv2.imread(str(folder / "images" / f"{k}.png"), cv2.IMREAD_GRAYSCALE)
        found, ids = detector.detectBoard(picture)[:2]
        if ids is None or len(ids) < 6:
            continue
        seen = np.full((len(corners), 2), np.nan)
        seen[ids.ravel()] = found.reshape(-1, 2)
        pose = yaml.safe_load((folder / "poses" / f"{k}.yaml").read_text())
        pixels.append(seen)
        p.append([pose[axis] for axis in "xyz"])
        R.append(Rotation.from_quat([pose[f"q{axis}"] for axis in "xyzw"]).as_matrix())
    lens = known["intrinsics"]
    camera = Camera(
        "static", "fixed", (1600, 1200), (lens["fx"], lens["fy"]), (lens["cx"], lens["cy"]), "brown", (0.0,) * 4, "free"
    )
    rig = Rig((camera,), (Board("board", "flange", tuple(map(tuple, corners.tolist()))),))
    result = hand_eye(np.array(p), np.array(R), rig, np.array(pixels))
    assert len(pixels) >= 12
    assert 0.1 < np.nanmedian(result.left_px) < 1.5
    assert 0.1 < result.scatter.sigma_px < 1.0
    assert result.rig.cameras[0].values[0] == pytest.approx(lens["fx"], rel=0.05)
