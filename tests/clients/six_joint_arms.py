"""Six-joint arms by their tables, their kinematics and its inverse by steps, which share nothing with Kilter's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
PRESETS = Path(__file__).parents[2] / "core" / "kilter_core" / "arm" / "presets"
# Rows of theta offset deg, d mm, a mm, alpha deg; and the signs of the joints.
ROWS = {
    "irb120": (
        [(0, 290, 0, -90), (-90, 0, 270, 0), (0, 0, 70, -90), (0, 302, 0, 90), (0, 0, 0, -90), (180, 72, 0, 0)],
        (1,) * 6,
    ),
    "kr6-r900": (
        [(0, 400, 25, -90), (0, 0, 455, 0), (-90, 0, 35, -90), (0, 420, 0, 90), (0, 0, 0, -90), (180, 80, 0, 0)],
        (-1, 1, 1, -1, 1, -1),
    ),
    "ur10e": (
        [(0, 180.7, 0, 90), (0, 0, -612.7, 0), (0, 0, -571.55, 0), (0, 174.15, 0, 90), (0, 119.85, 0, -90), (0, 116.55, 0, 0)],
        (1,) * 6,
    ),
}  # fmt: skip


class Arm:
    """An arm of these tables: ``errors`` are added to its numbers, ``theta_offset_2`` and so on, deg and mm."""

    def __init__(self, preset: str, errors: dict[str, float] | None = None) -> None:
        rows, self.signs = ROWS[preset]
        self.rows = np.array(rows, dtype=np.float64)
        self.beta = np.zeros(6)
        for name, value in (errors or {}).items():
            what, _, k = name.rpartition("_")
            if what == "beta":
                self.beta[int(k) - 1] += value
            else:
                self.rows[int(k) - 1, ("theta_offset", "d", "a", "alpha").index(what)] += value

    def frames(self, q_deg: Floats) -> list[Floats]:
        """Frames (4, 4) mm after each joint."""
        T, out = np.eye(4), []
        for k, (offset, d, a, alpha) in enumerate(self.rows):
            turn = np.radians(offset + self.signs[k] * q_deg[k])
            T = T @ about("z", turn) @ shift(a, 0, d)
            T = T @ about("x", np.radians(alpha)) @ about("y", np.radians(self.beta[k]))
            out.append(T)
        return out

    def flange(self, q_deg: Floats) -> Floats:
        """Flange (4, 4) mm in the frame of the root."""
        return self.frames(q_deg)[-1]

    def joints(self, flange: Floats, start_deg: Floats) -> Floats:
        """Joints near these that bring the flange to a pose, by Newton's method."""
        q = np.array(start_deg, dtype=np.float64)
        for _ in range(30):
            now = self.flange(q)
            step = apart(now, flange)
            if np.abs(step).max() < 1e-11:
                return q
            J = np.array(
                [(apart(now, self.flange(q + d)) - apart(now, self.flange(q - d))) / 2e-4 for d in np.eye(6) * 1e-4]
            )
            q = q + np.linalg.solve(J.T, step)
        raise AssertionError("no joints reach this pose")

    def wrist(self, q_deg: Floats) -> Floats:
        """Where axes 5 and 6 meet, mm."""
        return np.asarray(self.frames(q_deg)[4][:3, 3])


def about(axis: str, angle: float) -> Floats:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
    return T


def shift(x: float, y: float, z: float) -> Floats:
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return T


def apart(a: Floats, b: Floats) -> Floats:
    """Way (6,) from one pose to another, mm and rad times 100 mm."""
    turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
    return np.concatenate([b[:3, 3] - a[:3, 3], 100.0 * turn])


def limits_deg(preset: str) -> Floats:
    document = json.loads((PRESETS / f"{preset}.json").read_text())
    return np.array([joint["limits_deg"] for joint in document["joints"]], dtype=np.float64)
