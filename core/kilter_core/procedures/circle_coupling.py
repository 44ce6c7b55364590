"""Circles of a joint whose follower is read against the horizontal: its link goes round, but does not rotate.

On FANUC's and on parallelogram arms the third joint's reading is its angle in space. While the second moves alone, the forearm
keeps its direction, so every point goes round a circle of the upper arm's length about a middle of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.types import Bools, Floats

ROTATES = 0.02  # markers that rotate with a joint by 30 degrees change by a quarter of their distances
COUPLED_PARALLEL = math.cos(math.radians(2.0))


def checked_follows(follows: Mapping[int, int], prismatic: Bools) -> dict[int, int]:
    """Return follower -> leader (from 0) of revolute joints.

    Raises:
        ObservationError: a joint that is not there, is prismatic, or does not come after the one it follows.

    """
    for follower, leader in follows.items():
        if not 0 <= leader < follower < len(prismatic) or prismatic[follower] or prismatic[leader]:
            raise ObservationError(
                f"Joint {follower + 1} cannot follow joint {leader + 1}: both must be revolute, and the follower comes "
                f"after the leader; the rows have {len(prismatic)} joints.",
                follower=follower + 1,
                joint=leader + 1,
            )
    return dict(follows)


def keeps_direction(points: Floats) -> bool:
    """Return whether points (N, m, 3) move without rotation."""
    if points.shape[1] < 2:
        return False
    body = points - points.mean(axis=1, keepdims=True)
    size = float(np.sqrt(np.mean(body**2)))
    return float(np.sqrt(np.mean((body - body.mean(axis=0)) ** 2))) < ROTATES * size


def refuse_coupled(leader: int, follower: int) -> None:
    """Refuse circles that show a follower.

    Raises:
        ObservationError: always.

    """
    pair = f"j{follower + 1}=j{leader + 1}"
    raise ObservationError(
        f"The points of joint {leader + 1} go round but do not rotate: another joint moved along. It is joint {follower + 1}, "
        f"whose axis is parallel: its reading is the angle in space, not the one to link {leader + 1}, as on FANUC's and on "
        f"parallelogram arms. Uncouple them: --follows {pair} (over HTTP follows={pair}).",
        code="circle_not_round",
        joint=leader + 1,
        follower=follower + 1,
    )


def leader_point(angle: Floats, middle: Floats, direction: Floats, centre: Floats, at: float, elbow: Floats) -> Floats:
    """Return a point (3,) on the leader's axis.

    The middle of all points (N, 3) at readings ``angle`` goes round ``centre`` as ``elbow``, a point on the follower's axis
    while the leader was at ``at``, goes round the axis.
    """
    rotated = np.array([_rotate_about_axis(direction, at - a, p - centre) for a, p in zip(angle, middle, strict=True)])
    arm = rotated.mean(axis=0)
    return np.asarray(elbow - (arm - direction * (direction @ arm)))


def _rotate_about_axis(z: Floats, angle: float, v: Floats) -> Floats:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(c * v + s * np.cross(z, v) + (1.0 - c) * (z @ v) * z)
