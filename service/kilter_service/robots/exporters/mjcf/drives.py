"""Numbers of a drive in MuJoCo: a gain that sags as the joint does, friction that winds it up, a hinge that has backlash."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm import JointForm, Robot, axial_loads, joint_loads
from kilter_core.model import workspace
from kilter_core.types import Floats

RIGID = 1e-8  # rad (m): what a joint without compliance sags by under its largest load
LEAST_LOAD = 1.0  # N m (N): so that a tool on a light arm does not bend a rigid joint
# A joint that friction holds creeps in MuJoCo, and the slower the more inertia it has: this time constant makes it
# k / 20 000 in a second, for a wind-up k.
STUCK_S = 0.1
FRICTION = {"solreffriction": "0.01 1", "solimpfriction": "0.9999 0.9999 1e-6 0.5 2"}
# The documented limits are soft by millimetres, these by micrometres. At a time constant of one or two steps they never
# come to rest: 10 ms hold up to steps of 5 ms.
LIMITS = {"solreflimit": "0.015 1", "solimplimit": "0.99 0.9999 1e-6 0.5 2"}
# implicitfast takes the gain of a drive at the old angle: a joint has the inertia that keeps two steps in a radian of its
# swing, so that gains that are rigid come to rest. It changes nothing at rest.
LARGEST_STEP_S, STEADY = 5e-3, 4.0
BACKLASH_ARMATURE_S2 = 0.02  # kg m² for each N m of load: a limit is passed by half a microradian
LEAST_ARMATURE, BACKLASH_RATE = 1e-2, 10.0  # kg m² (kg); 1/s, at which backlash that nothing loads comes to rest


@dataclass(frozen=True)
class Drive:
    """Gain N m/rad, friction N m and armature kg m² of a joint; half the backlash behind it, rad, and its own armature.

    Of a prismatic joint N/m, N, kg, m.
    """

    gain: float
    friction: float
    armature: float
    backlash: float
    backlash_armature: float


def drives(robot: Robot, joints: list[JointForm]) -> list[Drive]:
    """The drive of each joint, whose ``joints`` are the part that elements hold."""
    largest = np.maximum(largest_loads(robot), LEAST_LOAD)
    return [_drive(joint, float(load)) for joint, load in zip(joints, largest, strict=True)]


def largest_loads(robot: Robot) -> Floats:
    """Largest load (n,) that weight works on each joint by, over the workspace."""
    return np.asarray(np.abs(axial_loads(robot, joint_loads(robot, workspace(robot).q))).max(axis=0))


def _drive(joint: JointForm, load: float) -> Drive:
    gain = 1.0 / joint.compliance if joint.compliance > 0.0 else load / RIGID
    windup = -0.5 * joint.reversal
    armature = gain * max(STUCK_S**2 if windup > 0.0 else 0.0, STEADY * LARGEST_STEP_S**2)
    own = max(LEAST_ARMATURE, BACKLASH_ARMATURE_S2 * load) if joint.backlash > 0.0 else 0.0
    return Drive(gain, gain * windup, armature, joint.backlash, own)
