"""Corners in pictures that MuJoCo's own renderer draws: a board of thin boxes before its camera, and no lens of ours.

OpenGL puts the centre of the first pixel at 0.5, half a pixel from where OpenCV and Kilter have it.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from tests.clients.files.rig.see.boards import CHARUCO, board, page_of
from tests.clients.files.rig.see.raycaster import BLACK
from tests.clients.files.rig.see.test_detection import MOST_BIAS_PX, seen

WIDTH, HEIGHT, FINE, FOVY_DEG = 800, 600, 4, 40.0  # FINE pixels across each
LOOKS = [
    ((25.0, -20.0, 10.0), (10.0, -5.0, 330.0)),
    ((-30.0, 15.0, 40.0), (0.0, 0.0, 360.0)),
    ((20.0, 30.0, -70.0), (10.0, 10.0, 350.0)),
]
THICK_M = 5e-4  # half of the paper
DRAW = """
import json, sys
import mujoco, numpy as np
given = json.load(open(sys.argv[1]))
model = mujoco.MjModel.from_xml_string(given["model"])
data = mujoco.MjData(model)
renderer = mujoco.Renderer(model, given["height"], given["width"])
out = []
for name in given["cameras"]:
    mujoco.mj_forward(model, data)
    renderer.update_scene(data, camera=name)
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    out.append(renderer.render().mean(axis=2))
np.save(sys.argv[2], np.array(out))
"""
TRIED = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 8, 8).render()"


def board_in_camera(look: tuple[Any, Any], middle: Any) -> tuple[Any, Any]:
    """Rotation and place, mm, of the board before a camera that looks along z, with y down."""
    R = Rotation.from_euler("xyz", look[0], degrees=True).as_matrix()
    return R, np.array(look[1]) - R @ middle


def scene(looks: list[tuple[Any, Any]], middle: Any) -> str:
    """The page as boxes in the room's frame, and a camera for each look at it."""
    page = page_of(CHARUCO)
    x, y, made = page.x.tolist(), page.y.tolist(), []
    for i, m in np.ndindex(len(x) - 1, len(y) - 1):  # side by side, so that none stands out above another
        place = f"{5e-4 * (x[i] + x[i + 1])!r} {5e-4 * (y[m] + y[m + 1])!r} {THICK_M!r}"
        size = f"{5e-4 * (x[i + 1] - x[i])!r} {5e-4 * (y[m + 1] - y[m])!r} {THICK_M!r}"
        colour = "0 0 0 1" if page.grey[m, i] == BLACK else "1 1 1 1"
        made.append(f'<geom type="box" pos="{place}" size="{size}" rgba="{colour}"/>')
    for k, look in enumerate(looks):
        R, p = board_in_camera(look, middle)
        axes = R.T @ np.diag([1.0, -1.0, -1.0])  # MuJoCo's camera looks along -z, with y up
        place = " ".join(map(repr, map(float, -1e-3 * R.T @ p)))
        xy = " ".join(map(repr, map(float, axes[:, :2].T.ravel())))
        made.append(f'<camera name="c{k}" pos="{place}" xyaxes="{xy}" fovy="{FOVY_DEG}"/>')
    size = f'offwidth="{WIDTH * FINE}" offheight="{HEIGHT * FINE}"'
    light = '<headlight ambient="0.8 0.8 0.8" diffuse="0 0 0" specular="0 0 0"/>'
    visual = f'<visual><global {size}/><quality offsamples="4"/>{light}<map znear="0.05" zfar="5"/></visual>'
    return f'<mujoco><statistic extent="1" center="0 0 0"/>{visual}<worldbody>{"".join(made)}</worldbody></mujoco>'


def truth(corners: Any, look: tuple[Any, Any], middle: Any) -> Any:
    R, p = board_in_camera(look, middle)
    points = corners @ R.T + p
    focal = 0.5 * HEIGHT / np.tan(np.radians(FOVY_DEG) / 2.0)
    return focal * points[:, :2] / points[:, 2:] + np.array([WIDTH, HEIGHT]) / 2.0 - 0.5


def renderer() -> str:
    """What draws without a window here, ``egl`` or ``osmesa``; skips the test where nothing does."""
    said = "PyOpenGL is not installed: pip install pyopengl"
    if importlib.util.find_spec("OpenGL") is not None:
        for one in ("egl", "osmesa"):
            made = subprocess.run(
                [sys.executable, "-c", TRIED], env={**os.environ, "MUJOCO_GL": one}, capture_output=True, text=True
            )
            if made.returncode == 0:
                return one
            said = (made.stderr.strip() or "killed by a signal").splitlines()[-1]
    pytest.skip(f"MuJoCo's renderer finds no EGL and no OSMesa (Debian: libegl1 libgl1-mesa-dri): {said}")


def test_corners_that_mujoco_draws_have_no_bias(tmp_path: Path) -> None:
    corners = np.array([[c["x_mm"], c["y_mm"], 0.0] for c in board(CHARUCO)[1]["corners"]])
    middle = corners.mean(axis=0)
    given, made = tmp_path / "given.json", tmp_path / "made.npy"
    cameras = [f"c{k}" for k in range(len(LOOKS))]
    size = {"width": WIDTH * FINE, "height": HEIGHT * FINE}
    given.write_text(json.dumps({"model": scene(LOOKS, middle), "cameras": cameras, **size}))
    subprocess.run([sys.executable, "-c", DRAW, given, made], check=True, env={**os.environ, "MUJOCO_GL": renderer()})
    off = []
    for k, fine in enumerate(np.load(made)):
        grey = fine.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3))
        grey = gaussian_filter(40.0 + 0.65 * grey, 0.7) + np.random.default_rng(k).normal(0.0, 1.0, grey.shape)
        view = seen(CHARUCO, np.clip(np.round(grey), 0, 255).astype(np.uint8))
        off.append(view.pixels - truth(corners, LOOKS[k], middle)[view.places])
        assert len(off[-1]) >= len(corners) - 2
    print("bias px", [one.mean(axis=0).round(4) for one in off], "scatter", np.concatenate(off).std().round(4))
    assert np.abs(np.concatenate(off).mean(axis=0)).max() <= MOST_BIAS_PX
