"""How far each joint can move the tool at most: the lever by which an error of a joint is bounded at the tool."""

from __future__ import annotations

import math

import numpy as np

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram
from kilter_core.types import Floats

PARALLEL = 1.0 - 1e-9


def levers(program: CorrectionProgram) -> Floats:
    """Most motion of the tool point (n,) per motion of each joint, m/rad or m/m, wherever the other joints are.

    For a revolute joint this is how far the tool can be from its axis: the links after it stretched out, those between
    parallel axes across these only. An upper bound, by the nominal arm; infinite behind a prismatic joint without limits.
    """
    m = program.moves
    moves, joints = program.array[: m + 1], program.array[m + 1 : m + 1 + program.n_joints]
    out = np.zeros(program.n_joints)
    for k in range(m):
        reach = 1.0 if moves[k, layout.KIND] else _farthest(moves[k + 1 :], joints)
        out[int(moves[k, layout.JOINT])] += abs(moves[k, layout.RATIO]) * reach
    return out


def _farthest(rows: Floats, joints: Floats) -> float:
    """How far the tool can be from a revolute axis; ``rows`` are those after its move, the last is up to the tool."""
    far, parallel = 0.0, True
    for k, row in enumerate(rows):
        x, y, z = row[layout.NOMINAL + 9 : layout.NOMINAL + 12].tolist()
        far += math.hypot(x, y) if parallel else math.hypot(x, y, z)
        parallel = parallel and abs(row[layout.NOMINAL + 8]) > PARALLEL
        if k + 1 < len(rows) and row[layout.KIND] and not parallel:  # a prismatic move along z
            joint = joints[int(row[layout.JOINT])]
            far += abs(row[layout.RATIO]) * max(abs(joint[layout.LOWER]), abs(joint[layout.UPPER]))
    return far
