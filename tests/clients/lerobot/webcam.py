"""A webcam, and a board on the gripper of a simulated SO-101: corners by a pinhole of its own, as `measure see` has them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.clients.lerobot.so101_twin import Twin, ticks

Floats = NDArray[np.float64]

SIZE, FOCAL = (1920, 1080), 1400.0
CORNERS = np.array([[x, y, 0.0] for y in (0.0, 20.0, 40.0) for x in (0.0, 20.0, 40.0, 60.0)])
READS_DEG = np.array([109.0, 99.0, 96.0, 94.0, 159.0])  # within the stops
LIMITS_DEG = np.array([60.0, 70.0, 70.0, 70.0, 140.0])


def rotation(axis: int, degrees: float) -> Floats:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R


@dataclass(frozen=True)
class View:
    reading: Floats
    side: Floats
    payload_kg: float
    pixels: Floats
    tool: Floats


BOARD = np.eye(4)
BOARD[:3, :3] = rotation(0, 100.0) @ rotation(1, 8.0)
BOARD[:3, 3] = [-25.0, 12.0, 18.0]


def camera() -> Floats:
    """Pose of the camera in the base frame, mm: beside the arm, looking at where its gripper works."""
    place, aim = np.array([620.0, -420.0, 420.0]), np.array([220.0, 0.0, 180.0])
    z = (aim - place) / np.linalg.norm(aim - place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), place
    return T


def project(tool: Floats) -> Floats | None:
    """Pixels (corners, 2) of the board, or None where it is not whole in the picture and turned to the camera."""
    eye = np.linalg.inv(camera())
    board = eye @ tool @ BOARD
    seen = CORNERS @ board[:3, :3].T + board[:3, 3]
    towards = board[:3, 2] @ (board[:3, 3] / np.linalg.norm(board[:3, 3]))
    if seen[:, 2].min() < 150.0 or abs(towards) < 0.35:
        return None
    pixels = FOCAL * seen[:, :2] / seen[:, 2:] + np.array([(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2])
    inside = (pixels > 5.0).all() and (pixels < np.array(SIZE) - 5.0).all()
    return pixels if inside else None


def views(twin: Twin, poses: int, rng: np.random.Generator, payloads: tuple[float, ...], noise_px: float) -> list[View]:
    """Views of as many poses, each with every payload and from both sides; the board is whole in each."""
    found: list[View] = []
    while len(found) < poses * len(payloads) * 2:
        found += _of_pose(twin, ticks(rng.uniform(-1.0, 1.0, 5) * LIMITS_DEG), rng, payloads, noise_px)
    return found


def views_near(
    twin: Twin,
    examples_deg: Sequence[Sequence[float]],
    rng: np.random.Generator,
    payloads: tuple[float, ...],
    noise_px: float,
) -> list[View]:
    """Views of a pose that somebody advised, as printed to whole degrees and driven by hand: the board must be whole in all."""
    example = np.round(np.array(examples_deg[int(rng.integers(len(examples_deg)))]))
    reading = ticks(np.clip(example + rng.uniform(-2.0, 2.0, 5), -READS_DEG, READS_DEG))
    own = _of_pose(twin, reading, rng, payloads, noise_px)
    assert own, f"the camera sees no whole board near {example}"
    return own


def advised(
    ask: Callable[[list[View]], Mapping[str, Any]],
    seen: list[View],
    take: Callable[[Sequence[Sequence[float]]], list[View]],
) -> tuple[Mapping[str, Any], list[View]]:
    """What the kit says after its advice was followed: views near its examples (``take``), until it asks for none."""
    while True:
        document = ask(seen)
        wanted = [one for one in document["loads"] if one["examples_deg"]]
        if not wanted:
            return document, seen
        for one in wanted:
            enough = len(seen) + one["wanted"]
            while len(seen) < enough:
                seen = [*seen, *take(one["examples_deg"])]


def _of_pose(
    twin: Twin, reading: Floats, rng: np.random.Generator, payloads: tuple[float, ...], noise_px: float
) -> list[View]:
    """Views of a pose with every payload and from both sides; none where the board is not whole in all."""
    own: list[View] = []
    for payload in payloads:
        first = np.where(rng.random(5) < 0.5, -1.0, 1.0)
        for side in (first, -first):
            tool = twin.settled(reading, side, payload)
            pixels = project(tool)
            if pixels is None:
                return []
            own.append(View(reading, side, payload, pixels + rng.normal(0.0, noise_px, pixels.shape), tool))
    return own


def written(folder: Path, name: str, seen: list[View]) -> tuple[Path, Path]:
    """The views as rows, and the file that describes camera and board."""
    names = [f"q{k}_deg" for k in range(1, 6)] + [f"dir{k}" for k in range(1, 6)] + ["payload_kg", "pose_id"]
    names += [f"{axis}{k}_px" for k in range(1, len(CORNERS) + 1) for axis in "uv"]
    poses = np.unique([view.reading for view in seen], axis=0, return_inverse=True)[1]
    lines = [",".join(names)]
    for view, pose in zip(seen, poses.ravel(), strict=True):
        cells = [*view.reading, *view.side, view.payload_kg, int(pose), *view.pixels.ravel()]
        lines.append(",".join(f"{cell:.10g}" for cell in cells))
    rows, rig = folder / f"{name}.csv", folder / f"{name}.json"
    rows.write_text("\n".join(lines) + "\n")
    eye = {
        "name": "webcam", "mount": "fixed", "width_px": SIZE[0], "height_px": SIZE[1], "fx_px": FOCAL, "fy_px": FOCAL,
        "cx_px": (SIZE[0] - 1) / 2, "cy_px": (SIZE[1] - 1) / 2, "distortion_model": "none", "distortion": [],
    }  # fmt: skip
    board = {"name": "board", "mount": "flange", "corners_mm": CORNERS.tolist()}
    rig.write_text(json.dumps({"cameras": [eye], "boards": [board]}))
    return rows, rig
