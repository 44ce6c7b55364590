"""How far joints and links are deflected where loads are taken: a sagging arm carries its weights at other levers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.chain import Chain
from kilter_core.types import Floats, Ints

# Rounds of loads where the arm hangs, after those at the readings, in predictions and in the corrector alike: with backlash and
# clearance in their middle, and then on their sides.
HANGING_ROUNDS, SIDED_ROUNDS = 3, 2


@dataclass(frozen=True)
class Deflection:
    """Of N rows: ``dq (N, n)``, added to the joint readings, rad or m, and ``xi (N, n, 6)``, twists behind the joints.

    A twist is (v, w), m and rad, in the frame after the joint's element; ``xi`` may be empty, (0, n, 6): none.
    """

    dq: Floats
    xi: Floats

    def __add__(self, other: Deflection) -> Deflection:
        if not len(self.xi) or not len(other.xi):
            return Deflection(self.dq + other.dq, self.xi if len(self.xi) else other.xi)
        return Deflection(self.dq + other.dq, self.xi + other.xi)

    @staticmethod
    def none(rows: int, joints: int) -> Deflection:
        """Of a rigid arm."""
        return Deflection(np.zeros((rows, joints)), np.zeros((0, joints, 6)))

    def select(self, rows: slice) -> Deflection:
        """Of some of the rows."""
        return Deflection(self.dq[rows], self.xi[rows] if len(self.xi) else self.xi)


def twisted_elements(chain: Chain) -> Ints:
    """Joint (E,) whose twist stands behind each element, -1 where none does."""
    slot = np.full(len(chain.elements), -1, dtype=np.int64)
    slot[list(chain.primary)] = np.arange(chain.n_joints)
    return slot
