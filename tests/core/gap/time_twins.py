"""Campaigns in which something changes with time or temperature: plain DH in numpy, shares no code with the core."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.observations import Observations

Floats = NDArray[np.float64]
# A UR10: theta offset, d, a, alpha.
DH = np.array([
    [0.0, 0.1273, 0.0, np.pi / 2], [0.0, 0.0, -0.612, 0.0], [0.0, 0.0, -0.5723, 0.0],
    [0.0, 0.163941, 0.0, np.pi / 2], [0.0, 0.1157, 0.0, -np.pi / 2], [0.0, 0.0922, 0.0, 0.0],
])  # fmt: skip
NOISE_M = 3e-5
BASE, TOOL = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.03, 0.12])
AWAY = np.array([2.4, -1.6, 0.3])  # of the arm from the instrument, where that matters


@dataclass(frozen=True)
class Twin:
    """A campaign and its truth: the last row before what happened, from 1, and how far the station or tool moved, m.

    ``turned (N, 3)`` rad is what the station rotated by, ``zeros (N, 6)`` what the joints turned by beyond their readings;
    ``dh (6, 4)`` is the arm as it was built.
    """

    rows: Observations
    row: int = 0
    joint: int = 0
    moved: float = 0.0
    turned: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    zeros: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    dh: Floats = field(default_factory=lambda: DH)

    def with_inclinometer(self, follows: float = 1.0, noise_rad: float = 2e-6) -> Observations:
        """The rows beside an inclinometer on the base that reads this share of its tilt."""
        reading = np.full((len(self.rows), 7, 3), np.nan)
        rng = np.random.default_rng(5)
        reading[:, 6, :2] = 3e-4 + follows * self.turned[:, :2] + noise_rad * rng.normal(size=(len(self.rows), 2))
        return replace(self.rows, tilt=reading)

    def with_link_encoders(self, follows: float = 1.0, noise_rad: float = 2e-6) -> Observations:
        """The rows beside encoders on the links that read this share of what the joints turned by beyond their readings."""
        rng = np.random.default_rng(6)
        reading = self.rows.q + follows * self.zeros + noise_rad * rng.normal(size=self.rows.q.shape)
        return replace(self.rows, link_q=reading)


def robot() -> Robot:
    """The nominal arm."""
    return robot_from_document(preset_document("ur10"))


def turned(w: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) of small rotation vectors (N, 3), to second order."""
    x, y, z = w.T
    o = np.zeros_like(x)
    K = np.stack([np.stack([o, -z, y], 1), np.stack([z, o, -x], 1), np.stack([-y, x, o], 1)], 1)
    return np.eye(3) + K + 0.5 * K @ K


def tool_points(q: Floats, dh: Floats, tool: Floats, strain: Floats | None = None) -> Floats:
    """Tool points (N, 3) in the frame of the base; ``q (N, 6)``, ``tool (N, 3)``, ``strain (N, 6)`` of the links."""
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    for joint, (offset, d, a, alpha) in enumerate(dh):
        c, s = np.cos(q[:, joint] + offset), np.sin(q[:, joint] + offset)
        ca, sa = np.cos(alpha), np.sin(alpha)
        o = np.zeros_like(c)
        a = a * (1.0 if strain is None else 1.0 + strain[:, joint])
        step = np.stack([
            np.stack([c, -s * ca, s * sa], 1), np.stack([s, c * ca, -c * sa], 1), np.stack([o, o + sa, o + ca], 1),
        ], 1)  # fmt: skip
        p = p + np.einsum("nij,nj->ni", R, np.stack([a * c, a * s, o + d], 1))
        R = R @ step
    return p + np.einsum("nij,nj->ni", R, tool)


def twin(kind: str, seed: int, size: float = 1.0, poses: int = 60, revisits: int = 20, clock: bool = True) -> Twin:
    """A campaign in which ``kind`` happened.

    base, tool, zero (steps), drift, walk, settling, zero_drift, column (with temperature), climbing (a smooth error of the
    pose, with poses measured from low to high), link (the upper arm warms where no thermometer is), bent (the same link
    bends instead, which no effect of the library does), air (the scale of the instrument follows the temperature), none.
    ``size`` scales what happened.
    """
    rng = np.random.default_rng([seed, 77])
    low = np.array([-2.8, -2.2, -2.0, -2.8, -2.5, -2.8])
    pose = rng.permutation(np.concatenate([np.arange(poses), np.tile(np.arange(revisits), 2)]))
    each = rng.uniform(low, np.array([2.8, -0.4, 2.0, 2.8, 2.5, 2.8]), (poses, 6))
    if kind == "climbing":
        pose = np.argsort(tool_points(each, DH, np.tile(TOOL, (poses, 1)))[:, 2], kind="stable")
    q, n = each[pose], len(pose)
    t = np.cumsum(rng.uniform(25.0, 40.0, n))
    u = (t - t[0]) / (t[-1] - t[0])
    dh = DH + rng.normal(size=DH.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    after = int(rng.integers(n // 4, 3 * n // 4))
    late = (np.arange(n) >= after).astype(np.float64)
    joint = int(rng.integers(1, 5))
    way, spin = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    shift, angle, dq, tool = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 6)), np.tile(TOOL, (n, 1))
    warm, moved = 21.0 + 4.0 * (1.0 - np.exp(-u / 0.4)) + 0.4 * np.sin(9.0 * u), 0.0
    if kind == "base":
        shift, angle, moved = size * 5e-4 * np.outer(late, way), size * 2e-4 * np.outer(late, spin), size * 5e-4
    elif kind == "tool":
        tool, moved = tool + size * 5e-4 * np.outer(late, way), size * 5e-4
    elif kind == "zero":
        dq[:, joint] = size * 5e-4 * late
    elif kind == "drift":
        shift, angle = size * 4e-4 * np.outer(u, way), size * 3e-4 * np.outer(u, spin)
    elif kind == "settling":
        gone = 1.0 - np.exp(-u / 0.2)
        shift, angle = size * 4e-4 * np.outer(gone, way), size * 3e-4 * np.outer(gone, spin)
    elif kind == "walk":
        shift = size * 4e-4 * np.cumsum(rng.normal(size=(n, 3)), axis=0) / np.sqrt(n)
    elif kind == "zero_drift":
        dq[:, joint] = size * 5e-4 * u
    elif kind == "column":
        # A column 0.8 m under the base whose one side is warmer: it bends as an arc, and carries the base along.
        bent = size * 1e-4 * np.outer(warm - 21.0, np.array([way[0], way[1], 0.0]) / np.hypot(*way[:2]))
        angle, shift = bent, 0.4 * np.stack([bent[:, 1], -bent[:, 0], 0.0 * u], 1)
    elif kind == "climbing":
        height = tool_points(q, DH, tool)[:, 2]
        angle = size * 3e-4 * np.outer(np.tanh(2.0 * height) + 0.5 * height**2, spin)
    warmed = np.zeros((n, len(DH)))  # strain of each link
    scale = np.ones(n)
    if kind == "link":
        warmed[:, 1] = size * 4e-4 * (1.0 - np.exp(-u / 0.15))
    elif kind == "bent":
        dq[:, 2] = size * 5e-4 * (1.0 - np.exp(-u / 0.15))  # the axis of joint 3 is the one that it bends about
        warmed[:, 1] = size * 3e-4 * (1.0 - np.exp(-u / 0.5))
    elif kind == "air":
        scale += size * 3e-5 * (warm - 21.0)
    points = tool_points(q + dq, dh, tool, warmed)
    points = np.einsum("nij,nj->ni", turned(angle), points) + shift + BASE
    if kind == "air":
        points = (points + AWAY) * scale[:, None]
    seen = points + NOISE_M * rng.normal(size=points.shape)
    columns: dict[str, Any] = {"t": t, "temperature_c": warm + 0.02 * rng.normal(size=n)} if clock else {}
    return Twin(Observations(q=q, position=seen, pose_id=pose, **columns), after, joint, moved, angle, dq, dh)
