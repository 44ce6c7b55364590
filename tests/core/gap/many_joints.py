"""Arms of six and seven axes that share effects among many joints: statics in plain numpy, none of the core's.

Gears give way to the load about their axes, play keeps a joint behind its motor by half its width, and bearings lean
by their clearance towards the load across the axis. Loads are those of the arm as it is drawn, and as it is moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.80665])
NOISE_M = 2e-5
TOOL = np.array([0.04, 0.03, 0.11])
BASE = np.array([0.2, -0.1, 0.3])
LOADS_KG = (0.0, 5.0)
HALF_PI = np.pi / 2.0
# Offset of the reading (rad), d, a (m), alpha (rad) of each joint; mass (kg) and its place in the frame after the row.
SEVEN = (
    np.array([
        [0, 0.36, 0, -HALF_PI], [0, 0, 0, HALF_PI], [0, 0.42, 0, HALF_PI], [0, 0, 0, -HALF_PI],
        [0, 0.40, 0, -HALF_PI], [0, 0, 0, HALF_PI], [0, 0.126, 0, 0],
    ]),
    np.array([4.0, 4.0, 3.0, 2.7, 1.7, 1.8, 0.3]),
    np.array([
        [0, -0.03, 0.12], [0.0003, 0.042, 0.059], [0, 0.03, -0.13], [0, 0.034, -0.067],
        [0.0001, 0.021, 0.076], [0, 0.0006, 0.0004], [0, 0, -0.02],
    ]),
    np.radians([170, 120, 170, 120, 170, 120, 175]),
)  # fmt: skip
SIX = (
    np.array([
        [0, 0.45, 0.10, -HALF_PI], [-HALF_PI, 0, 0.55, 0], [0, 0, 0.08, -HALF_PI], [0, 0.52, 0, HALF_PI],
        [0, 0, 0, -HALF_PI], [0, 0.095, 0, 0],
    ]),
    np.array([12.0, 14.0, 8.0, 5.0, 2.0, 0.5]),
    np.array([
        [-0.04, 0.05, 0.02], [-0.27, 0, 0.05], [-0.03, 0.02, 0.06], [0, -0.18, 0.01], [0, 0.01, 0.02], [0, 0, -0.03],
    ]),
    np.radians([170, 80, 110, 170, 115, 175]),
)  # fmt: skip
MOVED_M = 1e-4  # what an effect of one joint moves the tool by, about: the big gears of an arm are its good ones


@dataclass(frozen=True)
class Campaign:
    """The arm as a document, columns in SI, and what each joint truly has: amounts (n,) by effect, zero for none."""

    document: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    truth: dict[str, Floats]


def hidden(seed: int, axes: int, effects: tuple[str, ...], share: float) -> dict[str, Floats]:
    """Amounts by effect of a ``share`` of the joints, at least one; those with a load about or across them."""
    rng = np.random.default_rng([seed, axes, 5])
    rows, mass, com, limits = SEVEN if axes == 7 else SIX
    q = rng.uniform(-limits, limits, (50, axes))
    about = np.sqrt(np.mean(_moments(rows, mass, com, q, np.full(50, LOADS_KG[1] / 2.0))[:, :, 2] ** 2, axis=0))
    reach = np.cumsum(np.hypot(rows[:, 1], rows[:, 2])[::-1])[::-1] + TOOL[2]
    typical = {
        "axial_compliance": 1.0 / (about * reach + 1e-12),
        "backlash": -2.0 / reach,
        "clearance_tilt": 1.0 / reach,
    }
    out = {}
    for effect in effects:
        able = np.arange(axes) if effect == "backlash" else np.arange(1, axes - 1)
        count = max(1, round(share * len(able)))
        joints = rng.permutation(able)[:count]
        out[effect] = np.zeros(axes)
        out[effect][joints] = MOVED_M * typical[effect][joints] * rng.uniform(0.6, 1.6, count)
    return out


def campaign(
    seed: int, axes: int, truth: dict[str, Floats], poses: int = 78, revisited: int = 20, same_sides: bool = True
) -> Campaign:
    """Random poses, some of them visited three times, from either side and with either load, of an arm with errors.

    Unless a pose is visited from the ``same_sides`` again nothing tells the noise but what the fit leaves.
    """
    rng = np.random.default_rng([seed, axes, 6])
    rows, mass, com, limits = SEVEN if axes == 7 else SIX
    pose = np.concatenate([np.arange(poses), np.repeat(np.arange(revisited), 2)])
    q = rng.uniform(-limits, limits, (poses, axes))[pose]
    side = rng.choice([-1.0, 1.0], (poses, axes))[pose]
    if not same_sides:
        side = np.random.default_rng([seed, axes, 7]).choice([-1.0, 1.0], side.shape)
    payload = rng.choice(LOADS_KG, poses)[pose]
    made = rows + rng.normal(size=rows.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    tool, base = TOOL + 1e-3 * rng.normal(size=3), BASE + 2e-3 * rng.normal(size=3)
    about = _moments(rows, mass, com, q, payload)
    points = np.array([
        _point(made, q[i] + _turned(truth, about[i], side[i]), _leaning(truth, about[i]), tool) for i in range(len(q))
    ])  # fmt: skip
    position = points + base + NOISE_M * rng.normal(size=points.shape)
    columns = {"q": q, "direction": side, "payload_kg": payload, "pose_id": pose, "position": position}
    return Campaign(_document(rows, mass, com, limits), columns, truth)


def _turned(truth: dict[str, Floats], about: Floats, side: Floats) -> Floats:
    """Angles (n,) beyond the readings."""
    out = np.zeros(len(side))
    if "axial_compliance" in truth:
        out += truth["axial_compliance"] * about[:, 2]
    if "backlash" in truth:
        out += truth["backlash"] * side / 2.0
    return out


def _leaning(truth: dict[str, Floats], about: Floats) -> Floats:
    """Angles (n, 2) by which the axes lean about x and y: the thesis's share of the clearance each way."""
    if "clearance_tilt" not in truth:
        return np.zeros((len(about), 2))
    x, y = about[:, 0], about[:, 1]
    gamma = HALF_PI * np.abs(x) / np.maximum(np.abs(x) + np.abs(y), 1e-12)
    play = np.tan(truth["clearance_tilt"])
    across = np.stack([np.sign(x) * np.sin(gamma), np.sign(y) * np.cos(gamma)], 1) * play[:, None]
    return np.asarray(np.where((np.abs(x) + np.abs(y) > 1e-9)[:, None], across, 0.0))


def _rows(rows: Floats, q: Floats, lean: Floats) -> list[tuple[Floats, Floats]]:
    """Poses of one arm: of each joint, turned with it, and of the frame after its row, as 4x4 pairs."""
    out, here = [], np.eye(4)
    for (offset, d, a, alpha), angle, (u, v) in zip(rows, q, lean, strict=True):
        at = here @ _lift(d) @ _about(2, offset + angle)
        here = at @ _small(u, v) @ _along(a) @ _about(0, alpha)
        out.append((at, here))
    return out


def _moments(rows: Floats, mass: Floats, com: Floats, q: Floats, payload: Floats) -> Floats:
    """Moments (N, n, 3) N m of what each joint carries about it, along the axes of its frame."""
    out = np.zeros((*q.shape, 3))
    level = np.zeros((q.shape[1], 2))
    for i, angles in enumerate(q):
        frames = _rows(rows, angles, level)
        places = [after[:3, :3] @ c + after[:3, 3] for (_, after), c in zip(frames, com, strict=True)]
        tip = frames[-1][1]
        places.append(tip[:3, :3] @ TOOL + tip[:3, 3])
        weights = np.r_[mass, payload[i]]
        for j, (at, _) in enumerate(frames):
            arms = np.array(places[j:]) - at[:3, 3]
            out[i, j] = at[:3, :3].T @ np.sum(np.cross(arms, weights[j:, None] * GRAVITY), axis=0)
    return out


def _point(rows: Floats, q: Floats, lean: Floats, tool: Floats) -> Floats:
    tip = _rows(rows, q, lean)[-1][1]
    return np.asarray(tip[:3, :3] @ tool + tip[:3, 3])


def _about(axis: int, angle: float) -> Floats:
    out = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def _small(u: float, v: float) -> Floats:
    """A turn by the vector (u, v, 0)."""
    angle = float(np.hypot(u, v))
    if angle == 0.0:
        return np.eye(4)
    x, y = u / angle, v / angle
    K = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    return out


def _lift(d: float) -> Floats:
    out = np.eye(4)
    out[2, 3] = d
    return out


def _along(a: float) -> Floats:
    out = np.eye(4)
    out[0, 3] = a
    return out


def _document(rows: Floats, mass: Floats, com: Floats, limits: Floats) -> dict[str, Any]:
    return {
        "name": f"arm-of-{len(rows)}", "convention": "dh",
        "joints": [
            {"name": f"j{j + 1}", "limits_deg": [-float(np.degrees(x)), float(np.degrees(x))], "gear_ratio": None}
            for j, x in enumerate(limits)
        ],
        "rows": [
            {"type": "revolute", "theta_offset_deg": float(np.degrees(o)), "d_mm": float(d * 1e3),
             "a_mm": float(a * 1e3), "alpha_deg": float(np.degrees(x))}
            for o, d, a, x in rows
        ],
        "links": [
            {"mass_kg": float(m), "com_mm": [float(x) * 1e3 for x in c]} for m, c in zip(mass, com, strict=True)
        ],
        "tool": dict(zip(("x_mm", "y_mm", "z_mm"), (TOOL * 1e3).tolist(), strict=True)),
        "base": dict(zip(("x_mm", "y_mm", "z_mm"), (BASE * 1e3).tolist(), strict=True)),
    }  # fmt: skip
