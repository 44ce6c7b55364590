"""`kilter upload --cameras` and `kilter measure hand-eye` against a real server, and the files of ROS 2 that it writes."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from kilter_client import Kilter
from kilter_client.cli.camera.hand_eye import write_ros_files
from kilter_client.errors import FileError
from tests.clients.test_cli import Command
from tests.core.pixel_scene import eye_in_hand
from tests.service.test_pixels import columns, csv, described

SCENE = eye_in_hand({}, np.zeros(6))


def test_a_camera_on_the_flange_is_found_and_exported(kilter: Kilter, command: Command, tmp_path: Path) -> None:
    kilter.add_robot(SCENE.drawn.document() | {"name": "handy"})
    rng = np.random.default_rng(1)
    views, rig = tmp_path / "views.csv", tmp_path / "views.json"
    views.write_text(csv(columns(SCENE.observed(SCENE.poses(30, rng), rng, 0.1))))
    rig.write_text(json.dumps(described(SCENE) | {"rows": 30, "pixels": "centre of the top left pixel is (0, 0)"}))
    command("upload", "handy", views, "--cameras", rig, "--name", "views")
    ros = tmp_path / "ros"
    said = ("--base-link", "arm_base", "--flange-link", "arm_flange")
    job = command.json("hand-eye", "handy", "--campaign", "views", "--validation", "0.25", "--ros", ros, *said)
    assert job["result"]["parameters"] == []
    words = command("jobs", "show", job["id"], "--details")
    noise = re.search(r"noise of a corner: (\S+) px", words)
    assert noise is not None
    assert float(noise[1]) == pytest.approx(0.1, rel=0.1)
    assert "the tool in views held out is off by" in words
    assert "noise of a coordinate" not in words
    camera = job["result"]["cameras"][0]
    true = SCENE.drawn.tool * SCENE.eyes[0].pose
    place = np.array([camera[f"{k}_mm"] for k in "xyz"])
    assert np.abs(place - 1e3 * true.translation).max() < 0.3
    assert camera["frame"] == "flange"

    transforms = yaml.safe_load((ros / "static_transforms.yaml").read_text())
    one = next(t for t in transforms if t["child"] == "hand_optical_frame")
    assert one["parent"] == "arm_flange"
    turned = Rotation.from_quat([one["rotation"][k] for k in "xyzw"]).as_matrix()
    assert np.abs(turned - true.rotation).max() < 1e-3
    joints = ET.fromstring((ros / "hand_eye.urdf.xacro").read_text()).findall("joint")
    origin = next(j for j in joints if j.find("child").get("link") == "hand_optical_frame").find("origin")
    assert np.abs(np.array(origin.get("xyz").split(), dtype=float) - true.translation).max() < 3e-4
    by_urdf = Rotation.from_euler("xyz", np.array(origin.get("rpy").split(), dtype=float)).as_matrix()
    assert np.abs(by_urdf - turned).max() < 1e-6
    info = yaml.safe_load((ros / "camera_info_hand.yaml").read_text())
    assert info["distortion_model"] == "plumb_bob"
    assert info["camera_matrix"]["data"][0] == SCENE.eyes[0].focal[0]
    assert len(info["distortion_coefficients"]["data"]) == 5
    shell = (ros / "static_transforms.sh").read_text()
    assert "--frame-id arm_base --child-frame-id wall_board" in shell


def test_poses_are_planned_for_a_camera(kilter: Kilter, command: Command, tmp_path: Path) -> None:
    kilter.add_robot(SCENE.drawn.document() | {"name": "planned"})
    rng = np.random.default_rng(2)
    views, rig, poses = tmp_path / "views.csv", tmp_path / "views.json", tmp_path / "poses.csv"
    views.write_text(csv(columns(SCENE.observed(SCENE.poses(15, rng), rng, 0.1))))
    rig.write_text(json.dumps(described(SCENE)))
    command("upload", "planned", views, "--cameras", rig, "--name", "views")
    assert "already" in command("upload", "planned", views, "--cameras", rig, "--name", "views")
    command("plan", "poses", "planned", "--campaign", "views", "--views", "--count", "8", "-o", poses)
    q = np.radians(np.loadtxt(poses, delimiter=",", skiprows=1)[:, :6])
    assert len(q) == 8
    assert not np.isnan(SCENE.pixels(q, SCENE.eyes[0], SCENE.sheets[0])).any()
    said = command("identify", "planned", "--campaign", "views", "--option", "level=1", "--details")
    assert re.search(r"camera and arm agree to [\d.]+ mm, with shuffled joints to \d{2,4}", said)
    assert "name a version that was identified" in command("plan", "poses", "planned", "--views", code=1)


def test_what_is_no_rig_is_refused(server: Path, command: Command, tmp_path: Path) -> None:
    rows, rig = tmp_path / "views.csv", tmp_path / "rig.json"
    rows.write_text("q1_deg,u1_px,v1_px\n1,2,3\n")
    for text in ("{}", "[1]", '{"cameras": [], "boards": []}'):
        rig.write_text(text)
        assert "kilter measure see" in command("upload", "any", rows, "--cameras", rig, code=2)


def test_files_of_ros_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    frames, nothing = {"base": "base_link", "flange": "tool0"}, {"cameras": [], "boards": []}
    (tmp_path / "ros" / "static_transforms.sh").mkdir(parents=True)
    with pytest.raises(FileError, match=r"static_transforms\.sh: cannot be written"):
        write_ros_files(nothing, tmp_path / "ros", frames)
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="file: cannot be made"):
        write_ros_files(nothing, tmp_path / "file", frames)
