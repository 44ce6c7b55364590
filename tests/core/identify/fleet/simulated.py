"""Arms of one type, in plain numpy: the same chain, each with errors of its own about errors that the type has in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.observations import Observations

Floats = NDArray[np.float64]

# d m, a m, alpha rad of each joint, as drawings of an arm of 1 m reach have them.
ROWS = np.array(
    [[0.33, 0.05, 1.0], [0.0, 0.40, 0.0], [0.0, 0.035, 1.0], [0.42, 0.0, -1.0], [0.0, 0.0, 1.0], [0.08, 0.0, 0.0]]
) * [1.0, 1.0, np.pi / 2.0]
TOOL = np.array([0.07, -0.04, 0.11])
LENGTH, ANGLE = 3e-4, np.radians(0.03)
PARALLEL = 1  # the joint whose axis the next one is parallel to: a turn about y tells them apart


@dataclass(frozen=True)
class Arm:
    """Errors (6, 5) of theta, d, a, alpha and of a turn about y after each joint; where its base and tool are."""

    errors: Floats
    base: Floats
    tool: Floats

    def points(self, q: Floats) -> Floats:
        """Where an instrument sees the tool point (N, 3) m at joints (N, 6) rad."""
        T = np.tile(self.base, (len(q), 1, 1))
        for k in range(6):
            d, a, alpha = ROWS[k]
            theta_error, d_error, a_error, alpha_error, y_error = self.errors[k]
            T = T @ turned("z", q[:, k] + theta_error) @ shifted(0.0, 0.0, d + d_error)
            T = T @ shifted(a + a_error, 0.0, 0.0) @ turned("x", np.full(len(q), alpha + alpha_error))
            T = T @ turned("y", np.full(len(q), y_error))
        return np.asarray((T @ np.append(self.tool, 1.0))[:, :3])

    def measured(self, q: Floats, rng: np.random.Generator, noise: float) -> Observations:
        p = self.points(q)
        return Observations(q, position=p + rng.normal(0.0, noise, p.shape))


def turned(axis: str, angle: Floats) -> Floats:
    """Rotations (N, 4, 4) about an axis."""
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T[:, i, i] = T[:, j, j] = np.cos(angle)
    T[:, i, j], T[:, j, i] = -np.sin(angle), np.sin(angle)
    return T


def shifted(x: float, y: float, z: float) -> Floats:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


@dataclass(frozen=True)
class Type:
    """What arms of a type have in common, and how far they spread about it."""

    errors: Floats
    length: float = LENGTH
    angle: float = ANGLE

    @staticmethod
    def drawn(rng: np.random.Generator) -> Type:
        return Type(spread(rng, LENGTH, ANGLE))

    def arm(self, rng: np.random.Generator, shift: float = 0.0) -> Arm:
        """An arm of the type; ``shift`` moves each of its errors by so many spreads, to either side."""
        errors = self.errors + spread(rng, self.length, self.angle)
        errors = errors + shift * spread(rng, self.length, self.angle, signs=True)
        base = shifted(*rng.normal(0.0, 0.3, 3)) @ turned("z", rng.uniform(-1.0, 1.0, 1))[0]
        return Arm(errors, base, TOOL + rng.normal(0.0, 2e-3, 3))


def spread(rng: np.random.Generator, length: float, angle: float, signs: bool = False) -> Floats:
    drawn = rng.choice([-1.0, 1.0], (6, 5)) if signs else rng.standard_normal((6, 5))
    drawn *= [angle, length, length, angle, angle]
    drawn[[k for k in range(6) if k != PARALLEL], 4] = 0.0
    return np.asarray(drawn)


def document(name: str = "arm") -> dict[str, Any]:
    """The nominal arm that all of them are made as."""
    return {
        "name": name, "convention": "dh",
        "rows": [{"theta_offset_deg": 0.0, "d_mm": d * 1e3, "a_mm": a * 1e3, "alpha_deg": float(np.degrees(alpha))}
                 for d, a, alpha in ROWS],
        "joints": [{"name": f"j{k + 1}", "limits_deg": [-150, 150]} for k in range(6)],
        "tool": {"x_mm": 70.0, "y_mm": -40.0, "z_mm": 110.0, "rx_deg": 0, "ry_deg": 0, "rz_deg": 0},
    }  # fmt: skip


def poses(count: int, rng: np.random.Generator) -> Floats:
    return rng.uniform(-2.4, 2.4, (count, 6))
