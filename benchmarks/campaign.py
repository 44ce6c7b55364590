"""The campaign every tool is given: a UR10 with table errors, in plain numpy, sharing code with none of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Modified DH of a UR10 (alpha rad, a mm, theta rad, d mm), the table pybotics ships.
UR10 = np.array([
    [0.0, 0.0, 0.0, 118.0],
    [np.pi / 2, 0.0, np.pi, 0.0],
    [0.0, 612.7, 0.0, 0.0],
    [0.0, 571.6, 0.0, 163.9],
    [-np.pi / 2, 0.0, 0.0, 115.7],
    [np.pi / 2, 0.0, np.pi, 92.2],
])  # fmt: skip
TOOL_MM = np.array([50.0, 20.0, 100.0])
TRAIN, HELD_OUT = 118, 500
NOISE_MM = 0.02
ERRORS = np.array([1e-3, 0.5, 1e-3, 0.5])  # standard deviations, as the columns of the table


@dataclass(frozen=True)
class Campaign:
    """Joints rad and positions mm to fit and to predict."""

    q: Floats
    position: Floats
    q_held: Floats
    position_held: Floats

    def save(self, path: Path) -> None:
        """Write all arrays to an npz file, which any tool can read."""
        np.savez(
            path,
            q=self.q,
            position=self.position,
            q_held=self.q_held,
            position_held=self.position_held,
            table=UR10,
            tool=TOOL_MM,
        )


def positions(table: Floats, q: Floats) -> Floats:
    """Tool points (N, 3) mm of Rx(alpha) Tx(a) Rz(theta + q) Tz(d) chains."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (alpha, a, theta, d), angle in zip(table, q.T, strict=True):
        c, s, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        step = np.zeros((len(q), 4, 4))
        step[:, 0, 0], step[:, 0, 1], step[:, 0, 3] = c, -s, a
        step[:, 1, 0], step[:, 1, 1], step[:, 1, 2], step[:, 1, 3] = s * ca, c * ca, -sa, -sa * d
        step[:, 2, 0], step[:, 2, 1], step[:, 2, 2], step[:, 2, 3] = s * sa, c * sa, ca, ca * d
        step[:, 3, 3] = 1.0
        T = T @ step
    return np.asarray(T[:, :3, :3] @ TOOL_MM + T[:, :3, 3])


def campaign(seed: int = 0) -> Campaign:
    """118 noisy positions to fit, 500 exact ones to predict."""
    rng = np.random.default_rng(seed)
    truth = UR10 + rng.normal(size=UR10.shape) * ERRORS
    q, held = rng.uniform(-2.5, 2.5, (TRAIN, 6)), rng.uniform(-2.5, 2.5, (HELD_OUT, 6))
    noise = rng.normal(0.0, NOISE_MM, (TRAIN, 3))
    return Campaign(q, positions(truth, q) + noise, held, positions(truth, held))
