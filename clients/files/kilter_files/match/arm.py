"""A robot's own geometry in the client: the axes of its joints at zero, as the server resolves them, and where they go.

The server's check of a robot document gives axes and tool of any convention; a product of exponentials needs no more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.tables.joint_log import JointLog


@dataclass(frozen=True)
class Arm:
    """Axes at zero: ``direction`` and ``point`` (k, 3) mm, the ``joint`` that drives each times ``ratio``; the tool's pose."""

    name: str
    joints: int
    joint: NDArray[np.int64]
    ratio: Floats
    slides: NDArray[np.bool_]
    direction: Floats
    point: Floats
    home_turn: Floats
    home_mm: Floats

    def reading(self, log: JointLog) -> Floats:
        """Return the joints of a log (n, joints) in rad and mm.

        Raises:
            FileError: the log has another number of joints, or an angle for a prismatic joint.

        """
        if len(log.joints) != self.joints:
            what = f"has {len(log.joints)} joints, and the robot {self.name} has {self.joints}"
            raise fault(log.path, what, "Is it the log of another robot? Name the robot that was measured.")
        slides = {int(j) for j in self.joint[self.slides]}
        for i, name in enumerate(log.joints):
            if (i in slides) != name.endswith(("_mm", "_m")):
                what = f"joint {i + 1} of {self.name} is {'prismatic' if i in slides else 'revolute'}"
                raise fault(log.path, what, f"Name the column q{i + 1}_{'mm' if i in slides else 'deg'}.", column=name)
        turns = np.array([i not in slides for i in range(self.joints)])
        return np.asarray(np.where(turns, np.radians(log.q_even()), log.q_even()))

    def poses(self, q: Floats) -> tuple[Floats, Floats]:
        """Return orientations (n, 3, 3) and positions (n, 3) mm of the tool at joints ``q`` (n, joints) in rad and mm."""
        turn, place = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        for k in range(len(self.joint)):
            turn, place = self._apply_joint(k, q, turn, place)
        return turn @ self.home_turn, np.einsum("nij,j->ni", turn, self.home_mm) + place

    def axes(self, q: Floats) -> list[tuple[Floats, Floats]]:
        """Return for each axis the orientation (n, 3, 3) of the link before it and the position (n, 3) of its point, mm."""
        turn, place, out = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)), []
        for k in range(len(self.joint)):
            out.append((turn, turn @ self.point[k] + place))
            turn, place = self._apply_joint(k, q, turn, place)
        return out

    def _apply_joint(self, k: int, q: Floats, turn: Floats, place: Floats) -> tuple[Floats, Floats]:
        amount = q[:, self.joint[k]] * self.ratio[k]
        if self.slides[k]:
            return turn, place + (turn @ self.direction[k]) * amount[:, None]
        own = rotations(self.direction[k] * amount[:, None])
        shift = self.point[k] - own @ self.point[k]
        return turn @ own, np.einsum("nij,nj->ni", turn, shift) + place


def rotations(vectors: Floats) -> Floats:
    """Return the rotations (n, 3, 3) about ``vectors`` (n, 3) by their lengths, rad (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle > 0, angle, 1.0)[:, None]).T
    nil = np.zeros_like(x)
    cross = np.stack([nil, -z, y, z, nil, -x, -y, x, nil], axis=1).reshape(-1, 3, 3)
    sine, rest = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + rest * (cross @ cross))


def arm_from_check(checked: Mapping[str, Any]) -> Arm:
    """Return the arm of the server's check of a robot document (``kilter.robots.check``)."""
    names, axes = [joint["name"] for joint in checked["joints"]], checked["axes"]
    tool = checked["zero"]["tool"]
    angles = [math.radians(tool[f"r{axis}_deg"]) for axis in "xyz"]
    about_x, about_y, about_z = rotations(np.diag(angles))
    return Arm(
        name=str(checked["name"]),
        joints=len(names),
        joint=np.array([names.index(axis["joint"]) for axis in axes], dtype=np.int64),
        ratio=np.array([axis["ratio"] for axis in axes], dtype=np.float64),
        slides=np.array([axis["kind"] == "prismatic" for axis in axes]),
        direction=np.array([axis["direction"] for axis in axes], dtype=np.float64),
        point=np.array([axis["point_mm"] for axis in axes], dtype=np.float64),
        home_turn=about_z @ about_y @ about_x,
        home_mm=np.array([tool[f"{axis}_mm"] for axis in "xyz"], dtype=np.float64),
    )
