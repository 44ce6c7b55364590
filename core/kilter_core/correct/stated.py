"""What a program promises of every correction it makes, read from the numbers that the kernel runs on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram
from kilter_core.types import Floats

TASKS = {3: "position", 5: "axis", 6: "pose"}  # by the number of rows that come first


@dataclass(frozen=True)
class Stated:
    """Task and limits of a program; of each joint (n,) the largest correction, its most rate and its most acceleration.

    ``held_joints`` (from 0) are those that it leaves as they are wanted.

    Units rad or m, per second and per second squared; ``farthest_m`` is the largest correction of the tool point.
    """

    task: str
    at_limit: Literal["saturate", "refuse"]
    largest: Floats
    farthest_m: float
    rate: Floats
    acceleration: Floats
    held_joints: tuple[int, ...]


def read_program_limits(program: CorrectionProgram) -> Stated:
    """What the program promises."""
    joints, scalars = program.array[program.moves + 1 : program.moves + 1 + program.n_joints], program.array[-1]
    return Stated(
        task=TASKS[int(scalars[layout.FIRST])],
        at_limit="saturate" if scalars[layout.SATURATES] else "refuse",
        largest=joints[:, layout.LARGEST].copy(),
        farthest_m=float(scalars[layout.FARTHEST]),
        rate=joints[:, layout.CHANGE].copy(),
        acceleration=joints[:, layout.SPURT].copy(),
        held_joints=tuple(np.flatnonzero(joints[:, layout.FREE] == 0.0).tolist()),
    )
