"""Simulated recordings of an arm with clocks that jump and markers that are knocked; shares no code with the client.

The arm that moves is not the nominal one: its DH table is off, its joints err with the angle, bend under gravity and
have play. The truth of every frame is kept, so that a wrong row can be counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray

# alpha, a, d, theta offset (standard DH; deg, mm): a collaborative arm and an industrial one
TABLES: dict[str, Array] = {
    "cobot": np.array(
        [[90, 0, 128, 0], [0, -612, 0, 0], [0, -572, 0, 0], [90, 0, 164, 0], [-90, 0, 116, 0], [0, 0, 92, 0]], float
    ),
    "industrial": np.array(
        [[-90, 150, 525, 0], [0, 600, 0, -90], [-90, 120, 0, 0], [90, 0, 620, 0], [-90, 0, 0, 0], [0, 0, 100, 180]], float
    ),
}  # fmt: skip
CENTRE = {"cobot": [0, -90, 80, -80, -90, 0], "industrial": [0, 0, 0, 0, 60, 0]}


@dataclass(frozen=True)
class Jump:
    """The clocks at ``at_s`` of the arm's time: afterwards log time - recording time is ``size_s`` more."""

    at_s: float
    size_s: float
    how: str  # "log" or "recording": whose clock is touched


@dataclass(frozen=True)
class Knock:
    """A marker (-1: the whole body) moved at ``at_s`` of the arm's time."""

    at_s: float
    marker: int
    shift_mm: Array
    turn: Array = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True)
class Plan:
    """What is simulated."""

    seed: int
    arm: str = "cobot"
    poses: int = 40
    cadence: str = "regular"  # every 3.1 s; or "irregular"
    order: str = "random"  # or "sorted": along the first joint
    rests: bool = True
    markers: int = 4
    noise_mm: float = 0.03
    rate_hz: float = 60.0
    log_hz: float = 100.0
    error: float = 1.0  # of the nominal robot, times what is usual
    jumps: tuple[Jump, ...] = ()
    knock: Knock | None = None


@dataclass(frozen=True)
class Made:
    """Recording (``t_s``, ``points``), log (``log_t``, ``log_q`` deg), and the truth: the arm's time and joints per frame."""

    plan: Plan
    t_s: Array
    points: Array
    log_t: Array
    log_q: Array
    arm_t: Array
    arm_q: Array
    poses: Array
    rest_at: Array  # (poses, 2) start and end of each rest, the arm's time


def schedule(plan: Plan) -> tuple[Array, Array]:
    """Rests (poses, 2) of the arm and the poses, deg."""
    rng = np.random.default_rng([plan.seed, 1])
    spread = np.array([70, 30, 35, 40, 40, 90.0])
    poses = np.array(CENTRE[plan.arm]) + rng.uniform(-1, 1, (plan.poses, 6)) * spread
    if plan.order == "sorted":
        poses = poses[np.argsort(poses[:, 0])]
    again = plan.poses // 8
    if again:
        poses[-again:] = poses[:again]
    regular = plan.cadence == "regular"
    rest = np.full(plan.poses, 2.0) if regular else rng.uniform(0.8, 3.5, plan.poses)
    move = np.full(plan.poses, 1.1) if regular else rng.uniform(0.7, 2.2, plan.poses)
    if not plan.rests:
        rest, move = np.full(plan.poses, 0.0), rng.uniform(1.2, 2.8, plan.poses)
    start = 1.0 + np.concatenate([[0], np.cumsum(rest + move)[:-1]])
    return np.stack([start, start + rest], axis=1), poses


def joints_at(t: Array, rests: Array, poses: Array, smooth: bool = True) -> Array:
    """Joints at the arm's time: rest at each pose, smooth moves between."""
    k = np.clip(np.searchsorted(rests[:, 0], t, side="right") - 1, 0, len(rests) - 1)
    after = np.minimum(k + 1, len(rests) - 1)
    span = np.maximum(rests[after, 0] - rests[k, 1], 1e-9)
    u = np.where(after > k, np.clip((t - rests[k, 1]) / span, 0, 1), 0.0)
    u = u**3 * (10 - 15 * u + 6 * u * u)
    if not smooth:  # without rests: one spline through the poses
        from scipy.interpolate import CubicSpline

        return CubicSpline(rests[:, 0], poses)(np.clip(t, rests[0, 0], rests[-1, 0]))
    return poses[k] + u[:, None] * (poses[after] - poses[k])


def forward(table: Array, q_deg: Array) -> tuple[Array, Array]:
    """Turns and places of the flange by the textbook's DH matrices."""
    T = np.broadcast_to(np.eye(4), (len(q_deg), 4, 4))
    for (alpha, a, d, offset), q in zip(table, q_deg.T, strict=True):
        c, s = np.cos(np.radians(q + offset)), np.sin(np.radians(q + offset))
        ca, sa = np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        nil, one = np.zeros_like(c), np.ones_like(c)
        A = np.array(
            [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [nil, sa * one, ca * one, d * one],
                [nil, nil, nil, one],
            ]
        )
        T = T @ np.moveaxis(A, 2, 0)
    return T[:, :3, :3], T[:, :3, 3]


def turn_of(rng: np.random.Generator, size_deg: float | None = None) -> Array:
    """A random rotation, or one by ``size_deg`` about a random axis."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(0, np.pi) if size_deg is None else np.radians(size_deg)
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def measured(plan: Plan, t: Array, q_deg: Array) -> Array:
    """What a tracker sees of the markers (n, markers, 3) without noise: the true arm, not the nominal one."""
    rng = np.random.default_rng([plan.seed, 2])
    table = TABLES[plan.arm] + rng.normal(0, 1, (6, 4)) * [0.05, 0.4, 0.4, 0.08] * plan.error
    wave, phase = np.abs(rng.normal(0, 0.01, 6)), rng.uniform(0, 2 * np.pi, 6)
    true = q_deg + wave * np.sin(np.radians(q_deg) + phase)
    true[:, 1] += 0.02 * np.cos(np.radians(q_deg[:, 1])) + 0.01 * np.cos(np.radians(q_deg[:, 1] + q_deg[:, 2]))
    play = rng.uniform(0, 0.004, 6)
    true = true + play * np.sign(np.sin(np.radians(7.3 * q_deg + 40)))
    turns, places = forward(table, true)
    body = rng.uniform(-1, 1, (plan.markers, 3)) * [80, 80, 40]
    if plan.markers >= 3:
        body[:3] += np.array([[-70, -50, 0], [75, -45, 10], [0, 80, 15]])
    mount, lever = turn_of(rng), rng.uniform(-90, 90, 3)
    body = np.broadcast_to(body, (len(t), plan.markers, 3)).copy()
    if plan.knock is not None:
        after, k = t >= plan.knock.at_s, plan.knock.marker
        if k >= 0:
            body[after, k] += plan.knock.shift_mm
        else:
            body[after] = body[after] @ plan.knock.turn.T + plan.knock.shift_mm
    on_flange = body @ mount.T + lever
    points = np.einsum("nij,nmj->nmi", turns, on_flange) + places[:, None]
    base, at = turn_of(rng), rng.uniform(-2500, 2500, 3)
    points = points @ base.T + at
    centre = points.mean(axis=(0, 1))
    bend = rng.normal(0, 1e-8, (3, 3))  # a tracker's own distortion: some hundredths of a mm over its volume
    return points + np.sign(points - centre) * (points - centre) ** 2 @ bend


def make(plan: Plan) -> Made:
    """Simulate a plan."""
    rng = np.random.default_rng([plan.seed, 3])
    rests, poses = schedule(plan)
    end = rests[-1, 1] + 1.0
    offset, drift = rng.uniform(1.0, 6.0), rng.normal(0, 30e-6)
    t_s = np.arange(0, end + 25, 1 / plan.rate_hz)
    arm_t = _arm_time(t_s, [(j.at_s, -j.size_s) for j in plan.jumps if j.how == "recording"])
    keep = arm_t <= end
    t_s, arm_t = t_s[keep], arm_t[keep]
    # the log starts before the recording and ends after it
    log_t = np.arange(-12, end + 30, 1 / plan.log_hz)
    log_arm = _arm_time(log_t, [(j.at_s, j.size_s) for j in plan.jumps if j.how == "log"])
    log_q = joints_at(log_arm, rests, poses, plan.rests) + rng.normal(0, 5e-4, (len(log_t), 6))
    q = joints_at(arm_t, rests, poses, plan.rests)
    points = measured(plan, arm_t, q) + rng.normal(0, plan.noise_mm, (len(t_s), plan.markers, 3))
    points[rng.random((len(t_s), plan.markers)) < 0.01] = np.nan
    points[1:][np.diff(arm_t) == 0] = np.nan  # a device fills what it lost with markers it did not see
    log_t = (log_t + offset) * (1 + drift)
    return Made(plan, t_s, points, log_t, log_q, arm_t, q, poses, rests)


def _arm_time(clock: Array, jumps: list[tuple[float, float]]) -> Array:
    """The arm's time when a clock shows ``clock``: it leads the arm by the sizes of the jumps that were.

    A jump forward skips readings: those between stand still at the moment of the jump (a log that repeats its row). A jump
    back loses what the arm did meanwhile.
    """
    out = clock.copy()
    for at, size in sorted(jumps):
        moved = out > at
        out[moved] = np.where(size > 0, np.maximum(out[moved] - size, at), out[moved] - size)
    return out


def document(arm: str, name: str) -> dict[str, Any]:
    """The nominal robot as the contract's robot.json."""
    keys = ("alpha_deg", "a_mm", "d_mm", "theta_offset_deg")
    rows = [{"type": "revolute"} | dict(zip(keys, map(float, row), strict=True)) for row in TABLES[arm]]
    joints = [{"name": f"j{k}", "limits_deg": [-360, 360]} for k in range(1, 7)]
    return {"name": name, "convention": "dh", "rows": rows, "joints": joints}
