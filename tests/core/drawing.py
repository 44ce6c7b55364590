"""A pencil's circle drawn by an arm of :mod:`tests.core.truth`: what is commanded, and what is on the paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.core.campaigns import held
from tests.core.truth import Arm

Floats = NDArray[np.float64]

NORMAL = np.array([0.0, -1.0, 1.0]) / np.sqrt(2.0)
PLANE = np.stack([[1.0, 0.0, 0.0], np.cross(NORMAL, [1.0, 0.0, 0.0]), NORMAL], axis=1)


def ring(radius: float, turn: Floats) -> Floats:
    """Points (n, 3) m of a circle in the sheet's plane."""
    return radius * np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)


@dataclass(frozen=True)
class Drawing:
    """``q (n, joints)`` commanded at ``turn (n,)``; ``commanded`` in the robot's base, ``error`` (n, 3) on the sheet, m."""

    radius: float
    centre: Floats
    turn: Floats
    q: Floats
    commanded: Floats
    error: Floats

    def at_sheet(self) -> Floats:
        """What was drawn, in the sheet's frame."""
        return ring(self.radius, self.turn) + self.error

    def measured(self) -> Floats:
        """What was drawn, in the robot's base as the sheet is laid by its quarter points."""
        return self.centre + self.at_sheet() @ PLANE.T

    @property
    def out(self) -> Floats:
        """Errors out of the circle (n,)."""
        p = self.at_sheet()
        return np.hypot(p[:, 0], p[:, 1]) - self.radius

    @property
    def along(self) -> Floats:
        """Errors along the circle (n,)."""
        p = self.at_sheet()
        ahead = np.arctan2(p[:, 1], p[:, 0]) - self.turn
        return np.asarray((ahead + np.pi) % (2 * np.pi) - np.pi) * (self.radius + self.out)


def drawn(nominal: Arm, actual: Arm, start: Floats, centre: Floats, radius: float, count: int) -> Drawing:
    """Draw: the nominal arm is sent along the circle, the actual one draws, the sheet lies at the four quarters."""
    turn = 2 * np.pi * np.arange(count) / count
    commanded = centre + ring(radius, turn) @ PLANE.T
    q, here = [], start
    for point in commanded:
        here = held(nominal, here[None], lambda p, point=point: (p - point, np.eye(3)))[0]
        q.append(here)
    true = actual.poses(np.array(q))[0]
    sheet, quarters = ring(radius, turn), np.arange(4) * (count // 4)
    middle = true[quarters].mean(axis=0)
    U, _, V = np.linalg.svd(sheet[quarters].T @ (true[quarters] - middle))
    R = V.T @ np.diag([1.0, 1.0, np.linalg.det(V.T @ U.T)]) @ U.T
    at = (true - (middle - R @ sheet[quarters].mean(axis=0))) @ R
    return Drawing(radius, centre, turn, np.array(q), commanded, at - sheet)
