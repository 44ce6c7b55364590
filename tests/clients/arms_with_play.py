"""Arms of any number of axes, on a rail or not, with play in one joint and zeros that are off: plain numpy, without Kilter.

The joints move in turn through the poses of a list; play leaves each on the side that it came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
AXES = "zyyxyxzyxyzx"
LINKS_M = (0.25, 0.31, 0.28, 0.22, 0.19, 0.17, 0.15, 0.14, 0.13, 0.12, 0.11, 0.10)
ASIDE_M = 0.04
RAIL_M, TURN_RAD = 1.2, 1.3  # largest motion to either side
BALL_M = np.array([0.05, 0.03, 0.12])
NOISE_M = 1e-5


@dataclass(frozen=True)
class ArmWithPlay:
    """An arm of ``axes`` joints, the first a rail where it says so; joint ``loose``, from 1, lags by ``play_rad``."""

    axes: int
    rail: bool = False
    loose: int = 4
    play_rad: float = 6e-4
    seed: int = 3

    @property
    def loose_play_deg(self) -> float:
        """Half of its width, degrees."""
        return float(np.degrees(self.play_rad))

    @cached_property
    def zeros(self) -> Floats:
        """How far each joint's zero is off (n,) rad; the rail's is right."""
        off = np.random.default_rng(self.seed).normal(0.0, 1e-3, self.axes)
        off[0] *= not self.rail
        return off

    @property
    def _directions(self) -> Floats:
        return np.array([np.eye(3)["xyz".index(axis)] for axis in self._letters])

    @property
    def _letters(self) -> str:
        return ("x" + AXES if self.rail else AXES)[: self.axes]

    @property
    def _reach(self) -> Floats:
        return np.array([RAIL_M if self.rail and k == 0 else TURN_RAD for k in range(self.axes)])

    def urdf(self) -> str:
        """The arm as it is drawn: without errors."""
        rows = ['<robot name="arm"><link name="link_0"/>']
        for k, (axis, reach) in enumerate(zip(self._directions, self._reach, strict=True)):
            kind = "prismatic" if self.rail and k == 0 else "revolute"
            x, y, z = (0.0, 0.0, 0.0) if k == 0 else (ASIDE_M, 0.0, LINKS_M[k - 1])
            rows.append(
                f'<joint name="a{k + 1}" type="{kind}"><parent link="link_{k}"/><child link="link_{k + 1}"/>'
                f'<origin xyz="{x} {y} {z}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
                f'<limit lower="{-reach}" upper="{reach}" effort="1" velocity="1"/></joint><link name="link_{k + 1}"/>'
            )
        x, y, z = BALL_M
        rows.append(
            f'<joint name="holder" type="fixed"><parent link="link_{self.axes}"/><child link="ball"/>'
            f'<origin xyz="{x} {y} {z}"/></joint><link name="ball"/></robot>'
        )
        return "".join(rows)

    def ball(self, q: Floats) -> Floats:
        """Place of the ball (3,) m for joints (n,) in rad or m."""
        turned, at = Rotation.identity(), np.zeros(3)
        for k, (axis, value) in enumerate(zip(self._directions, q, strict=True)):
            if k:
                at = at + turned.apply(np.array([ASIDE_M, 0.0, LINKS_M[k - 1]]))
            if self.rail and k == 0:
                at = at + turned.apply(axis * value)
            else:
                turned = turned * Rotation.from_rotvec(axis * value)
        return np.asarray(at + turned.apply(BALL_M))

    def measured(self, poses: int, seed: int) -> str:
        """Write rows of so many random poses, every sixth approached again at the end, as a CSV file in contract columns."""
        rng = np.random.default_rng(seed)
        q = rng.uniform(-0.9, 0.9, (poses, self.axes)) * self._reach
        q = np.vstack([q, q[::6]])
        side, before, lines = np.ones(self.axes), np.zeros(self.axes), [",".join([*self.columns, "x_mm,y_mm,z_mm"])]
        slack = np.zeros(self.axes)
        slack[self.loose - 1] = self.play_rad
        for row in q:
            side, before = np.where(row != before, np.sign(row - before), side), row
            place = 1e3 * (self.ball(row + self.zeros - slack * side) + rng.normal(0.0, NOISE_M, 3))
            shown = [1e3 * v if self.rail and k == 0 else np.degrees(v) for k, v in enumerate(row)]
            lines.append(",".join(f"{value:.6f}" for value in [*shown, *place]))
        return "\n".join(lines) + "\n"

    @property
    def columns(self) -> list[str]:
        """Names of the joints' columns."""
        return [f"q{k + 1}_{'mm' if self.rail and k == 0 else 'deg'}" for k in range(self.axes)]
