"""Campaigns with one effect of a known size, small or large: plain DH in numpy, shares no code with the core."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_core.observations import Observations
from tests.core.gap.time_twins import BASE, DH, NOISE_M, TOOL, tool_points

Floats = NDArray[np.float64]
POSES, REVISITED, STEP = 60, 20, 45  # rows before STEP were measured before a step
JOINT = 2  # from 0, of what happens at a joint
WAY, SPIN = np.array([0.7, 0.5, -0.5]), np.array([0.5, -0.8, 0.3])
# What each parameter of an effect is, SI: m and rad, per s or per K.
SMALL = {
    "base_step": np.concatenate([5e-4 * WAY, 2e-4 * SPIN]),
    "tool_step": 5e-4 * WAY,
    "zero_step": np.array([5e-4]),
    "drift": np.concatenate([1e-7 * WAY, 8e-8 * SPIN]),
    "zero_drift": np.array([1.5e-7]),
    "session_shift": 5e-4 * WAY,
    "zero_thermal": np.array([4e-5]),
    "thermal_drift": np.concatenate([2e-5 * WAY, 1e-5 * SPIN]),
    "thermal_growth": np.array([2e-5]),
}
LARGE = dict.fromkeys(SMALL, 10.0) | {"thermal_growth": 4.0}  # times the small, within the physical range


@dataclass(frozen=True)
class Sized:
    """A campaign, the true amounts of its effect in the order of its parameters (SI), and how far it moved the tool (N,)."""

    rows: Observations
    truth: Floats
    moved: Floats


def sized(
    effect: str, seed: int, times: float = 1.0, poses: int = POSES, revisited: int = REVISITED, noise_m: float = NOISE_M
) -> Sized:
    """A UR10 with errors of its geometry, some poses ``revisited`` twice more, and ``times`` a small effect."""
    rng = np.random.default_rng([seed, 11])
    truth = times * SMALL[effect]
    pose = rng.permutation(np.concatenate([np.arange(poses), np.tile(np.arange(revisited), 2)]))
    low, high = np.array([-2.8, -2.2, -2.0, -2.8, -2.5, -2.8]), np.array([2.8, -0.4, 2.0, 2.8, 2.5, 2.8])
    q, n = rng.uniform(low, high, (poses, 6))[pose], len(pose)
    t = np.cumsum(rng.uniform(25.0, 40.0, n))
    warm = rng.uniform(20.0, 26.0, n)
    session = np.arange(n) % 2
    dh = DH + rng.normal(size=DH.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    before = np.where(np.arange(n) < STEP, -1.0, 0.0)  # the geometry is that of the rows after a step
    along = {
        "base_step": before, "tool_step": before, "zero_step": before, "drift": t - t[0], "zero_drift": t - t[0],
        "session_shift": session * 1.0,
    }.get(effect, warm - 20.0)  # fmt: skip
    points, still = (_points(effect, q, dh, np.outer(along * on, truth)) for on in (1.0, 0.0))
    seen = points + BASE + noise_m * rng.normal(size=points.shape)
    columns = {"session": session} if effect == "session_shift" else {}
    rows = Observations(q=q, position=seen, pose_id=pose, t=t, temperature_c=warm, **columns)
    return Sized(rows, truth, np.linalg.norm(points - still, axis=1))


def _points(effect: str, q: Floats, dh: Floats, amounts: Floats) -> Floats:
    """Tool points (N, 3) in the frame of the base as the geometry has it."""
    tool = np.tile(TOOL, (len(q), 1))
    if effect in ("zero_step", "zero_drift", "zero_thermal"):
        moved = q.copy()
        moved[:, JOINT] += amounts[:, 0]
        return tool_points(moved, dh, tool)
    if effect in ("tool_step", "session_shift"):
        return tool_points(q, dh, tool + amounts)
    if effect == "thermal_growth":
        each = zip(q, 1.0 + amounts[:, 0], strict=True)
        return np.array([tool_points(one[None], dh * [1.0, by, by, 1.0], TOOL[None])[0] for one, by in each])
    turned = Rotation.from_rotvec(amounts[:, 3:]).apply(tool_points(q, dh, tool))
    return np.asarray(turned + amounts[:, :3])
