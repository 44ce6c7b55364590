"""Base and tool frames: six small increments about a pose, each in the pose's own axes."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.chain import Axis
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

FRAME_AXES = ((Axis.TX, "x"), (Axis.TY, "y"), (Axis.TZ, "z"), (Axis.RX, "rx"), (Axis.RY, "ry"), (Axis.RZ, "rz"))
# Base and tool frames are found from scratch by the registration; these widths only keep an unobservable direction finite.
FRAME_LENGTH_PRIOR_M = 0.1
FRAME_ANGLE_PRIOR_RAD = 0.3


def frame_parameters(which: str) -> list[Parameter]:
    """Six increments of the ``which`` frame, named ``<which>_x`` to ``<which>_rz``."""
    return [
        Parameter(
            f"{which}_{name}",
            "rad" if axis.rotates else "m",
            0.0,
            FRAME_ANGLE_PRIOR_RAD if axis.rotates else FRAME_LENGTH_PRIOR_M,
            description=f"increment of the {which} frame in its own axes",
        )
        for axis, name in FRAME_AXES
    ]


def increment(six: Floats) -> Floats:
    """Tx Ty Tz Rx Ry Rz of six increments as a pose (4, 4)."""
    T = np.eye(4)
    for (axis, _), amount in zip(FRAME_AXES, six, strict=True):
        T = T @ axis.motion(amount)
    return T
