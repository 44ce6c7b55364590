"""Intrinsics: from files of other programs, and from views whose camera is known, with gates for what they covered."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_client.cli import run
from kilter_files.ground.errors import FileError
from kilter_files.rig.see.intrinsics import evaluate_gates
from kilter_files.rig.see.optics.camera import read_camera
from kilter_files.rig.see.optics.intrinsics_fit import Seen, fit_intrinsics, median_view_rms
from tests.clients.files.rig.see.boards import board
from tests.clients.files.rig.see.raycaster import Lens

LENSES = {
    "none": Lens(1600, 1200, (1500.0, 1510.0), (810.0, 590.0)),
    "brown": Lens(1600, 1200, (1400.0, 1395.0), (790.0, 610.0), "brown", (-0.28, 0.12, 0.001, -0.0007, -0.03)),
    "rational": Lens(
        1600, 1200, (1200.0, 1195.0), (805.0, 600.0), "rational", (0.4, 0.1, 5e-4, -4e-4, 0.0, 0.7, 0.2, 0.0)
    ),
    "fisheye": Lens(1600, 1200, (620.0, 622.0), (801.0, 598.0), "fisheye", (-0.02, 0.004, -0.002, 0.0)),
}
GRID = np.array([[x, y, 0.0] for y in range(6) for x in range(8)]) * 30.0


def views(lens: Lens, count: int = 30, tilt_deg: float = 35.0, noise: float = 0.05, seed: int = 1) -> list[Seen]:
    rng = np.random.default_rng(seed)
    found: list[Seen] = []
    while len(found) < count:
        turn = Rotation.from_euler("xyz", [*rng.uniform(-tilt_deg, tilt_deg, 2), rng.uniform(-180, 180)], degrees=True)
        depth = rng.uniform(350, 700) * lens.focal[0] / 1400
        aim = rng.uniform([0, 0], [lens.width, lens.height])
        middle = np.array([*lens.rays(aim[:1], aim[1:]), np.ones((1, 1))]).ravel() * depth
        points = turn.apply(GRID - GRID.mean(axis=0)) + middle
        pixels = lens.pixels(points)
        inside = (pixels > 3).all(axis=1) & (pixels < np.array([lens.width, lens.height]) - 4).all(axis=1)
        inside &= points[:, 2] > 50
        if inside.sum() >= 8:
            noisy = pixels[inside] + rng.normal(0, noise, (inside.sum(), 2))
            found.append(Seen(f"view {len(found) + 1}", GRID[inside], noisy, noise))
    return found


@pytest.mark.parametrize("model", LENSES)
def test_a_known_camera_is_found_within_its_intervals(model: str) -> None:
    lens = LENSES[model]
    seen = views(lens)
    fit = fit_intrinsics(seen, (1600, 1200), model)
    camera = fit.camera
    off = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]) - [*lens.focal, *lens.centre]
    sigmas = np.array(camera.sigmas_px[:4])
    print(f"{model}: off {off.round(3)} px, sigmas {sigmas.round(3)}, rms {fit.rms_px:.4f}")
    assert np.abs(off / sigmas).max() < 4
    assert sigmas.max() < 2
    assert fit.rms_px == pytest.approx(0.05, rel=0.08)
    assert all(gate.met for gate in evaluate_gates(seen, fit))
    # what matters of a lens: where it puts things, all over the picture
    corners = np.array([[x, y, 1.0] for x in (-0.45, 0, 0.45) for y in (-0.35, 0, 0.35)])
    from kilter_files.rig.see.optics.camera import project_points

    values = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])
    assert np.abs(project_points(corners, values, model) - lens.pixels(corners)).max() < 0.5


def test_standard_deviations_are_those_of_repeats() -> None:
    lens = LENSES["none"]
    fits = [fit_intrinsics(views(lens, 15, seed=seed), (1600, 1200), "none").camera for seed in range(12)]
    pulls = [(fit.fx_px - lens.focal[0]) / fit.sigmas_px[0] for fit in fits]
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.8


def test_the_gates_are_apart_from_what_is_left() -> None:
    lens = LENSES["none"]
    facing = views(lens, tilt_deg=3.0)
    fit = fit_intrinsics(facing, (1600, 1200), "none")
    assert fit.rms_px < 0.06
    assert {gate.name for gate in evaluate_gates(facing, fit) if not gate.met} == {"tilts"}
    middle = [Seen(v.picture, v.mm[near], v.pixels[near]) for v in views(lens, 60)
              if (near := np.linalg.norm(v.pixels - [800, 600], axis=1) < 350).sum() >= 12]  # fmt: skip
    fit = fit_intrinsics(middle, (1600, 1200), "none")
    assert {gate.name for gate in evaluate_gates(middle, fit) if not gate.met} >= {"cells", "edge"}


def test_wrong_corners_are_left_out() -> None:
    lens = LENSES["brown"]
    seen = views(lens)
    for view in seen[:5]:
        view.pixels[0] += 6.0
    fit = fit_intrinsics(seen, (1600, 1200), "brown")
    assert 5 <= fit.left_out <= 12
    assert abs(fit.camera.fx_px - lens.focal[0]) < 5 * fit.camera.sigmas_px[0]


def test_too_few_views() -> None:
    with pytest.raises(FileError, match="2 views have 6 corners or more: intrinsics need 3") as refused:
        fit_intrinsics(views(LENSES["none"], 2), (1600, 1200), "brown")
    assert refused.value.code == "intrinsics_too_few_views"


ROS = """image_width: 1600
image_height: 1200
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [1400.0, 0.0, 790.0, 0.0, 1395.0, 610.0, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.28, 0.12, 0.001, -0.0007, -0.03]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [620.0, 622.0, 801.0, 598.0]
  distortion_model: equidistant
  distortion_coeffs: [-0.02, 0.004, -0.002, 0.0]
  resolution: [1600, 1200]
cam1:
  camera_model: pinhole
  intrinsics: [1400.0, 1395.0, 790.0, 610.0]
  distortion_model: radtan
  distortion_coeffs: [-0.28, 0.12, 0.001, -0.0007]
  resolution: [1600, 1200]
"""


def opencv(path: Path, lens: tuple[float, ...]) -> str:
    store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    store.write("image_width", 1600)
    store.write("image_height", 1200)
    store.write("camera_matrix", np.array([[1400.0, 0, 790], [0, 1395, 610], [0, 0, 1]]))
    store.write("distortion_coefficients", np.array(lens).reshape(-1, 1))
    store.release()
    return path.read_text()


def test_files_of_other_programs(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(ROS)
    ros = read_camera(path)
    assert (ros.name, ros.size, ros.distortion_model, ros.known) == ("narrow", (1600, 1200), "brown", "fixed")
    assert ros.distortion == LENSES["brown"].k
    path.write_text(KALIBR)
    wide, narrow = read_camera(path, "cam0"), read_camera(path, "cam1")
    assert (wide.distortion_model, wide.distortion) == ("fisheye", LENSES["fisheye"].k)
    assert (narrow.distortion_model, narrow.distortion) == ("brown", (-0.28, 0.12, 0.001, -0.0007, 0.0))
    with pytest.raises(FileError, match="cam0, cam1"):
        read_camera(path)
    for ending in ("yml", "xml"):
        for lens, model in (((-0.28, 0.12, 0.001, -0.0007, -0.03), "brown"), ((0.0,) * 5, "none"),
                            (LENSES["rational"].k, "rational"), ((*LENSES["rational"].k, 0, 0, 0, 0), "rational")):  # fmt: skip
            opencv(tmp_path / f"c.{ending}", lens)
            camera = read_camera(tmp_path / f"c.{ending}")
            assert (camera.distortion_model, camera.fx_px, camera.cy_px) == (model, 1400.0, 610.0)
    old = opencv(tmp_path / "c.yml", (0.1, 0, 0, 0)).replace("%YAML 1.2", "%YAML:1.0")
    path.write_text(old)
    assert read_camera(path).distortion == (0.1, 0.0, 0.0, 0.0, 0.0)
    for camera in (ros, wide):  # known cameras leave nothing in views of their own, and much in those of another
        lens = LENSES[camera.distortion_model]
        left = median_view_rms(views(lens, 5), camera)
        assert left is not None
        assert left < 0.1
    other = median_view_rms(views(LENSES["rational"], 5), ros)
    assert other is not None
    assert other > 0.5


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a: [", "is not YAML"),
        ("- 1", "has no camera"),
        ("a: 1", "with nine numbers"),
        (ROS.replace("1400.0, 0.0, 790.0", "1400.0, 3.0, 790.0"), "skewed"),
        (ROS.replace("image_width: 1600\n", ""), "how large its pictures are"),
        (ROS.replace("plumb_bob", "ptlens"), "its lens is 'ptlens'"),
        (ROS.replace("-0.03]", "-0.03, 0.1]"), "numbers of distortion"),
        (ROS.replace("1400.0", ".nan"), "fx_px is nan, not a number"),
        (ROS.replace("1400.0", "1.4"), "not a focal length"),
        (KALIBR.replace("radtan", "fov"), "has the lens fov"),
        (KALIBR.replace("pinhole", "omni"), "is omni"),
        (KALIBR.replace("[1600, 1200]", "[1600]"), "lacks four intrinsics"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "has a document type"),
        ("<a", "is not XML"),
        ("{", "is not JSON"),
        ('{"width_px": 640}', "height_px is missing"),
        ('{"cameras": []}', "has 0 cameras"),
        ("\x00\x01", "is not YAML"),
    ],
)
def test_files_that_are_no_intrinsics(content: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(content)
    with pytest.raises(FileError) as refused:
        read_camera(path, "cam1")
    assert said in str(refused.value)
    assert str(path) in str(refused.value)


def test_the_real_camera(shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = shared_data / "charuco-industrial" / "images"
    if not folder.is_dir():
        pytest.skip("the pictures of the industrial arm are not there")
    sizes = ["--square-mm", "36.195", "--marker-mm", "18.256", "--dictionary", "6x6_250"]
    path = board(("--columns", "5", "--rows", "7", *sizes))[0]
    given = ["see", str(folder), "--board", str(path), "-o", str(tmp_path / "views.csv"), "--json"]
    capsys.readouterr()
    assert run([*given, "--intrinsics", "none"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    report, [camera] = document["intrinsics"], document["cameras"]
    print(report["rms_px"], camera["fx_px"], camera["sigmas_px"])
    assert 0.3 < report["rms_px"] < 0.6
    for name, known in (("fx_px", 1352.027), ("fy_px", 1356.143), ("cx_px", 789.671), ("cy_px", 627.300)):
        sigma = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), camera["sigmas_px"], strict=False))[name]
        assert abs(camera[name] - known) < 3 * sigma
    assert camera["intrinsics"] == "free"  # nothing was in the picture's corners
    assert [gate["name"] for gate in report["gates"] if not gate["met"]] == ["edge"]
    assert any("pictures' noise makes" in text for text in document["warnings"])
    assert len(list(csv.DictReader((tmp_path / "views.csv").read_text().splitlines()))) == 16
    narrow = camera | {"fx_px": 700, "fy_px": 700, "sigmas_px": None, "intrinsics": "fixed"}
    (tmp_path / "camera.json").write_text(json.dumps(narrow))
    capsys.readouterr()
    assert run([*given, "--camera", str(tmp_path / "camera.json")]) == 0
    assert "they are of another camera" in json.loads(capsys.readouterr().out)["warnings"][-1]
