"""What a simulator's model states of the servo of a joint, as the numbers of the kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.rollout.kernels import joint as place
from kilter_core.types import Floats


@dataclass(frozen=True)
class Servo:
    """Armature kg m2, friction N m, damping N m s/rad of joint and servo, gain N m/rad, and the limit of its torque, 0: none.

    ``impedance`` and ``rate`` 1/s are those of MuJoCo's friction; a rate of 0 holds without creep.
    """

    armature: float
    friction: float
    joint_damping: float
    servo_damping: float
    gain: float
    torque_limit: float = 0.0
    impedance: float = 1.0
    rate: float = 0.0

    def numbers(self) -> Floats:
        """Numbers (COUNT,) of a joint that has nothing else."""
        p = np.zeros(place.COUNT)
        damping = self.joint_damping + self.servo_damping
        p[place.ARMATURE], p[place.FRICTION], p[place.DAMPING] = self.armature, self.friction, damping
        p[place.GAIN], p[place.TORQUE_LIMIT] = self.gain, self.torque_limit
        p[place.SERVO_SHARE] = self.servo_damping / damping if damping > 0.0 else 0.0
        p[place.IMPEDANCE], p[place.RATE], p[place.SLIP_SPEED] = self.impedance, self.rate, 1.0
        return p
