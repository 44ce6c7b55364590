"""Poses that the kit advises show the board: to cameras whose pictures OpenCV and a pinhole of the tests' own compute."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_files.rig.kit import coverage
from kilter_files.rig.kit.coverage import capture_from_files
from kilter_files.rig.kit.loads import Sought, count_gravity_directions
from tests.clients.lerobot.so101_arm import PRESET, tool
from tests.clients.lerobot.so101_twin import Twin
from tests.clients.lerobot.webcam import BOARD, CORNERS, FOCAL, SIZE, View, camera, project, rotation, views, written

Floats = NDArray[np.float64]
CHAIN: dict[str, Any] = json.loads(PRESET.read_text())
WORN = Twin([0.0, 1.5, -1.0, 0.8, 0.0], [300.0, 30.0, 28.0, 40.0, 300.0], [0.0, 0.0, 1.0, 0.0, 0.0])
HIDDEN = ", and at no pose that changes that does the camera see the board"
REMEDY = "move the camera, or fix the board to another side of the gripper, and take all views anew"


@pytest.fixture(scope="module")
def seen() -> list[View]:
    """Twelve poses of a worn arm, each with two payloads from both sides."""
    return views(WORN, 12, np.random.default_rng(11), (0.0, 0.2), 0.5)


def test_every_pose_that_is_advised_shows_the_whole_board(tmp_path: Path, seen: list[View]) -> None:
    """On the worn arm, from both sides and with both payloads, although only the nominal arm was known."""
    rows, rig = written(tmp_path, "views", seen)
    capture = capture_from_files([rows], CHAIN["joints"], CHAIN, json.loads(rig.read_text()))
    asked = [one for one in capture.pulled if one.wanted]
    assert asked[0].joint == 2
    assert [one.shown for one in asked] == [True] * len(asked)
    for one in asked:
        assert one.missing is not None
        assert one.missing.endswith("deg, where the camera sees the board")
        for example in one.examples_deg:
            for side in (-1.0, 1.0):
                for kg in (0.0, 0.2):
                    assert project(WORN.settled(np.array(example), np.full(5, side), kg)) is not None, example


def test_a_joint_that_moved_too_little_gets_poses_that_show_the_board(tmp_path: Path, seen: list[View]) -> None:
    """The elbow and the first joint, kept within 30 degrees: they move far enough at every pose that is advised."""
    for joint in (0, 2):
        little = [view for view in seen if abs(view.reading[joint] - seen[0].reading[joint]) < 15.0]
        more = [view for view in views(WORN, 30, np.random.default_rng(12), (0.0,), 0.5) if abs(
            view.reading[joint] - seen[0].reading[joint]) < 15.0]  # fmt: skip
        rows, rig = written(tmp_path, f"little-{joint}", little + more)
        capture = capture_from_files([rows], CHAIN["joints"], CHAIN, json.loads(rig.read_text()))
        told = next(line for line in capture.missing if line.startswith(f"motion of joint {joint + 1} "))
        assert told.endswith("deg, where the camera sees the board")
        wanted = float(told.split(" would do")[0].split(" ")[-1])
        stood = np.array([view.reading[joint] for view in little + more])
        for text in re.findall(r"\(([-0-9, ]+)\)", told.split("near ")[1]):
            example = np.array([float(one) for one in text.split(",")])
            assert np.ptp([*stood, example[joint]]) > wanted - 1.0
            for side in (-1.0, 1.0):
                assert project(WORN.settled(example, np.full(5, side), 0.2)) is not None, example


def test_views_that_do_not_say_where_the_camera_stands_leave_that_to_the_person(
    tmp_path: Path, seen: list[View]
) -> None:
    """Of four views, and of a camera that somebody moved between them."""
    rows, rig = written(tmp_path, "few", seen[:4])
    few = capture_from_files([rows], CHAIN["joints"], CHAIN, json.loads(rig.read_text())).pulled[0]
    moved = [
        View(one.reading, one.side, one.payload_kg, one.pixels + 400.0 * (k % 2), one.tool)
        for k, one in enumerate(seen)
    ]
    rows, rig = written(tmp_path, "moved", moved)
    of_moved = capture_from_files([rows], CHAIN["joints"], CHAIN, json.loads(rig.read_text())).pulled[0]
    for one in (few, of_moved):
        assert one.shown is None
        assert one.examples_deg
        assert one.missing is not None
        assert "until the camera sees the board: these views do not say where it stands" in one.missing


def through_lens(points: Floats, lens: list[float], fisheye: bool) -> Floats:
    """Pixels of points (m, 3) before the camera, by OpenCV."""
    K = np.array([[FOCAL, 0.0, SIZE[0] / 2], [0.0, FOCAL, SIZE[1] / 2], [0.0, 0.0, 1.0]])
    nil = np.zeros(3)
    if fisheye:
        found = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), nil, nil, K, np.array(lens))[0]
    else:
        found = cv2.projectPoints(points, nil, nil, K, np.array(lens))[0]
    return np.asarray(found, dtype=float).reshape(-1, 2)


@pytest.mark.parametrize("mount", ["fixed", "flange"])
@pytest.mark.parametrize(
    ("model", "lens"), [("brown", [-0.12, 0.05, 1e-3, -5e-4, 0.0]), ("fisheye", [0.03, -0.01, 0.0, 0.0])]
)
def test_camera_and_board_are_where_they_stand(mount: str, model: str, lens: list[float]) -> None:
    """With lenses, by names and by numbers of the rows, and with the camera on the gripper and the board on the table."""
    rng, rows, flanges = np.random.default_rng(5), list[dict[str, Any]](), list[Floats]()
    stands, held = (camera(), BOARD) if mount == "fixed" else (table(), eye())
    while len(rows) < 30:
        q = rng.uniform(-1.0, 1.0, 5) * [60.0, 70.0, 70.0, 70.0, 140.0]
        before = before_the_camera(tool(q), stands, held, mount)
        points = CORNERS @ before[:3, :3].T + before[:3, 3]
        if points[:, 2].min() < 100.0 or abs(before[:3, 2] @ before[:3, 3]) < 0.4 * np.linalg.norm(before[:3, 3]):
            continue
        pixels = through_lens(points, lens, model == "fisheye")
        if (pixels > 5.0).all() and (pixels < np.array(SIZE) - 5.0).all():
            named = ("webcam", "sheet") if len(rows) % 2 else (1.0, 1.0)
            cells = {f"{axis}{k + 1}_px": pixels[k, i] for k in range(len(CORNERS)) for i, axis in enumerate("uv")}
            rows.append({**cells, "camera": named[0], "board": named[1]})
            flanges.append(tool(q))
    rig = {
        "cameras": [{"name": "webcam", "mount": mount, "width_px": SIZE[0], "height_px": SIZE[1], "fx_px": FOCAL,
                     "fy_px": FOCAL, "cx_px": SIZE[0] / 2, "cy_px": SIZE[1] / 2, "distortion_model": model,
                     "distortion": lens}],
        "boards": [{"name": "sheet", "mount": "flange" if mount == "fixed" else "fixed", "corners_mm": CORNERS.tolist()}],
    }  # fmt: skip
    (found,) = coverage.sights(rows, np.array(flanges), rig)
    assert found.margin_px < 0.1
    assert found.world_side == pytest.approx(stands, abs=0.05)
    assert found.tool_side == pytest.approx(held, abs=0.05)


def before_the_camera(flange: Floats, stands: Floats, held: Floats, mount: str) -> Floats:
    """Pose of the board before the camera; ``held`` is what is on the flange."""
    found: Floats = np.linalg.inv(stands) @ flange @ held
    return found if mount == "fixed" else np.linalg.inv(found)


def table() -> Floats:
    T = np.eye(4)
    T[:3, 3] = [260.0, -20.0, 0.0]
    return T


def eye() -> Floats:
    """A camera at the gripper that looks where it points."""
    T = np.eye(4)
    T[:3, :3] = rotation(1, 90.0) @ rotation(2, 4.0)
    T[:3, 3] = [-80.0, 8.0, 45.0]
    return T


def test_where_no_such_pose_shows_the_board_the_camera_is_to_be_moved(tmp_path: Path) -> None:
    """A camera before an arm that hardly rotates sees the board only while the gripper is low; one above it sees more."""
    low = [view for view in views(WORN, 60, np.random.default_rng(4), (0.0,), 0.5) if view.reading[1] > 20.0]
    rows, rig = written(tmp_path, "low", low)
    limits = [(-20.0, 20.0), (-100.0, 100.0), (-30.0, 30.0), (-20.0, 20.0), (-20.0, 20.0)]
    joints = [{**joint, "limits_deg": pair} for joint, pair in zip(CHAIN["joints"], limits, strict=True)]
    lift = capture_from_files([rows], joints, CHAIN, json.loads(rig.read_text())).pulled[0]
    assert (lift.fewer, lift.examples_deg, lift.shown, lift.missing) == (0, (), False, None)
    assert lift.untold is not None
    assert lift.untold.endswith(f"{HIDDEN}: {REMEDY}")
    q = np.array([view.reading for view in low])
    document = json.loads(rig.read_text())
    (here,) = coverage.sights(
        [*csv.DictReader(rows.read_text().splitlines())], np.array([tool(one) for one in q]), document
    )
    assert here.world_side == pytest.approx(camera(), abs=60.0)
    elsewhere = [replace(here, world_side=_looking(place)) for place in PLACES]
    assert any(
        count_gravity_directions(Sought(CHAIN, q, limits, lambda one=one: [one]), [0.0] * len(q))[0].shown
        for one in elsewhere
    )


PLACES = [(-700.0, y, z) for y in (-400.0, 0.0, 400.0) for z in (300.0, 600.0, 900.0)]


def _looking(place: tuple[float, float, float]) -> Floats:
    """A camera at a place, looking at where the gripper is when the arm is tilted back."""
    z = np.array([-100.0, 0.0, 350.0]) - place
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), place
    return T
