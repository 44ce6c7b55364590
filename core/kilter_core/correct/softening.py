"""How soft the signs of loads are in a correction: a joint must not jump from one side of its backlash to the other.

A sign that is too soft leaves the backlash of a lightly loaded joint uncorrected, so what is soft for a shoulder is not for a
wrist: the width follows the load that each joint carries.
"""

from __future__ import annotations

import math

import numpy as np

from kilter_core.arm.loads.wrenches import axial_loads, joint_loads
from kilter_core.arm.robot import Payload, Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.types import Floats

SHARE = 0.005  # of the largest load of a joint
LEAST_NM = 1e-6
POSES = 64
UNBOUNDED_RAD, UNBOUNDED_M = math.pi, 0.5


def softening(form: RunTimeForm, robot: Robot, load: Payload, most_nm: float) -> tuple[Floats, Floats]:
    """Half-widths (n,) N·m of the signs of the load across each joint, and of that about it.

    The effect's own, and at least the smaller of ``most_nm`` and a share of the largest load of the joint over its range.
    """
    own = [np.array([getattr(joint, name) for joint in form.joints]) for name in _WIDTHS]
    if most_nm <= 0.0 or not any(joint.tilt or joint.backlash for joint in form.joints):
        return own[0], own[1]
    q = _poses(robot)
    com = np.tile(np.asarray(load.com, dtype=np.float64), (len(q), 1))
    loads = joint_loads(robot, q, payload_kg=np.full(len(q), load.mass), payload_com=com)
    across = np.linalg.norm(loads.joints[:, :, 3:5], axis=2).max(axis=0)
    about = np.abs(axial_loads(robot, loads)).max(axis=0)
    least = [np.clip(SHARE * largest, min(LEAST_NM, most_nm), most_nm) for largest in (across, about)]
    return np.maximum(own[0], least[0]), np.maximum(own[1], least[1])


_WIDTHS = ("tilt_softening_nm", "backlash_softening_nm")


def _poses(robot: Robot) -> Floats:
    """Joints (POSES, n) spread evenly over the ranges, the same at every call."""
    wide = np.array([UNBOUNDED_RAD if joint.kind == "revolute" else UNBOUNDED_M for joint in robot.joints])
    lower = np.maximum(np.array([joint.lower for joint in robot.joints]), -wide)
    upper = np.minimum(np.array([joint.upper for joint in robot.joints]), wide)
    return np.asarray(lower + (upper - lower) * np.random.default_rng(0).uniform(size=(POSES, robot.n_joints)))
