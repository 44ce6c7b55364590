"""A model's elements as kernel arrays: base increments, chain, tool increments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.chain import Chain, Element
from kilter_core.arm.frames import FRAME_AXES
from kilter_core.types import Floats, Ints


@dataclass(frozen=True)
class Program:
    """The model's elements (base increments, chain, tool increments) as kernel arrays, parameters aside."""

    axis: Ints
    joint: Ints
    ratio: Floats
    value: Floats
    slot: Ints
    tool_at: int
    element_of: Ints  # element of each geometric parameter


def model_program(chain: Chain) -> Program:
    """Kernel arrays of a chain between base and tool increments."""
    frame = [Element(axis) for axis, _ in FRAME_AXES]
    elements = [*frame, *chain.elements, *frame]
    slot = np.full(len(elements), -1, dtype=np.int64)
    for j, k in enumerate(chain.primary):
        slot[6 + k] = j
    slot[5], slot[-1] = chain.n_joints, chain.n_joints + 1
    named = [6 + k for k in chain.named_elements]
    tool_at = 6 + len(chain.elements)
    return Program(
        axis=np.array([e.axis for e in elements], dtype=np.int64),
        joint=np.array([-1 if e.joint is None else e.joint for e in elements], dtype=np.int64),
        ratio=np.array([e.ratio for e in elements]),
        value=np.array([e.value for e in elements], dtype=np.float64),
        slot=slot,
        tool_at=tool_at,
        element_of=np.array([*range(6), *named, *range(tool_at, tool_at + 6)], dtype=np.int64),
    )
