"""Where the arm stands before the device, and where the markers sit on its tool: what the robot's model explains of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.match.arm import Arm, rotations

NOISE_MM = 0.1
# what the geometry of a robot may be off, as standard deviations: an axis (rad, mm), the wave of a joint (rad)
AXIS_RAD, AXIS_MM, WAVE_RAD = 5e-3, 3.0, 1e-3
ENDED_MM = 1e-3


@dataclass(frozen=True)
class Registration:
    """Device = ``turn`` (base + errors) + ``place``; ``markers`` (m, 3) in the tool's frame; mm.

    ``errors`` are small errors of the arm, a column each of :func:`error_columns`; none when empty.
    """

    turn: Floats
    place: Floats
    markers: Floats
    errors: Floats

    def in_base(self, turns: Floats, places: Floats) -> Floats:
        """Return the markers (n, m, 3) in the base frame for poses of the tool."""
        return np.asarray(np.einsum("nij,mj->nmi", turns, self.markers) + places[:, None])

    def predict_markers(self, turns: Floats, places: Floats, columns: Floats | None = None) -> Floats:
        """Return where the device should see the markers (n, m, 3)."""
        points = self.in_base(turns, places)
        if columns is not None and len(self.errors):
            points = points + columns @ self.errors
        return np.asarray(points @ self.turn.T + self.place)


def register(turns: Floats, places: Floats, points: Floats, steps: int = 15) -> Registration:
    """Return the least-squares registration of poses of the tool with markers ``points`` (n, m, 3; NaN = not seen)."""
    found = _initial_registration(turns, places, points)
    for _ in range(steps):
        found, size = _step(found, turns, places, points, None)
        if size < ENDED_MM:
            break
    return found


def fit_arm_errors(
    arm: Arm, q: Floats, points: Floats, start: Registration, steps: int = 4
) -> tuple[Registration, Floats]:
    """Return a registration with small errors of the arm fitted too, and the columns of these errors."""
    turns, places = arm.poses(q)
    columns = error_columns(arm, q, start.in_base(turns, places))
    found = replace(start, errors=np.zeros(columns.shape[-1]))
    for _ in range(steps):
        found, _ = _step(found, turns, places, points, columns)
    return found, columns


def error_columns(arm: Arm, q: Floats, points: Floats) -> Floats:
    """Return how points (n, m, 3) in the base frame move (n, m, 3, errors) with small errors of the arm.

    Six for each axis (a rotation and a shift before it), and two for an error of its angle by sine and cosine. They are
    scaled by what is plausible, so that a fit holds them at size one.
    """
    out = []
    for k, (turn, at) in enumerate(arm.axes(q)):
        away = points - at[:, None]
        for i in range(3):
            out.append(np.cross(turn[:, None, :, i], away) * AXIS_RAD)
            out.append(np.broadcast_to(turn[:, None, :, i] * AXIS_MM, away.shape))
        if not arm.slides[k]:
            sweep = np.cross((turn @ arm.direction[k])[:, None], away) * WAVE_RAD
            angle = q[:, arm.joint[k]]
            out += [sweep * np.sin(angle)[:, None, None], sweep * np.cos(angle)[:, None, None]]
    return np.stack(out, axis=-1)


def marker_jacobian(found: Registration, turns: Floats, places: Floats, errors: Floats | None) -> Floats:
    """Return how the predicted markers (n, m, 3) move (n, m, 3, unknowns) with base, markers and errors."""
    n, m = len(turns), len(found.markers)
    points = found.predict_markers(turns, places, errors) - found.place
    out = np.zeros((n, m, 3, 6 + 3 * m))
    out[..., 0:3] = -_cross_product_matrices(points)
    out[..., 3:6] = np.eye(3)
    lever = found.turn @ turns
    for k in range(m):
        out[:, k, :, 6 + 3 * k : 9 + 3 * k] = lever
    return out if errors is None else np.concatenate([out, found.turn @ errors], axis=-1)


def _cross_product_matrices(points: Floats) -> Floats:
    x, y, z = np.moveaxis(points, -1, 0)
    nil = np.zeros_like(x)
    return np.stack([nil, -z, y, z, nil, -x, -y, x, nil], axis=-1).reshape(*points.shape[:-1], 3, 3)


def _step(
    found: Registration, turns: Floats, places: Floats, points: Floats, errors: Floats | None
) -> tuple[Registration, float]:
    left = points - found.predict_markers(turns, places, errors)
    seen = ~np.isnan(left)
    jacobian = marker_jacobian(found, turns, places, errors)[seen]
    side = jacobian.T @ left[seen]
    square = jacobian.T @ jacobian + 1e-9 * np.eye(jacobian.shape[1])
    if errors is not None:
        first = square.shape[0] - errors.shape[-1]
        held = np.arange(first, square.shape[0])
        square[held, held] += NOISE_MM**2
        side[first:] -= NOISE_MM**2 * found.errors
    step = np.linalg.solve(square, side)
    turn = rotations(np.asarray(step[None, :3], dtype=np.float64))[0]
    m = len(found.markers)
    moved = Registration(
        turn @ found.turn,
        found.place + step[3:6],
        found.markers + step[6 : 6 + 3 * m].reshape(m, 3),
        found.errors + step[6 + 3 * m :] if errors is not None else found.errors,
    )
    return moved, float(np.abs(jacobian @ step).max(initial=0.0))


def _initial_registration(turns: Floats, places: Floats, points: Floats) -> Registration:
    """Lay the tool points over the markers, then set the markers where they are on average; twice."""
    m = points.shape[1]
    markers = np.zeros((m, 3))
    turn, place = np.eye(3), np.zeros(3)
    for _ in range(3):
        own = np.einsum("nij,mj->nmi", turns, markers) + places[:, None]
        seen = ~np.isnan(points[..., 0])
        a, b = own[seen], points[seen]
        middle, there = a.mean(axis=0), b.mean(axis=0)
        u, _, v = np.linalg.svd((b - there).T @ (a - middle))
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        place = there - turn @ middle
        local = np.einsum("nji,nmj->nmi", turns, (points - place) @ turn - places[:, None])
        absent = np.isnan(local)
        markers = np.where(absent, 0.0, local).sum(axis=0) / np.maximum((~absent).sum(axis=0), 1)
    return Registration(turn, place, markers, np.zeros(0))
