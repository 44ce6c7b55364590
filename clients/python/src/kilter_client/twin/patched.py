"""A copy of a user's model of MuJoCo with the servos as a log shows them, and what they lack: as elements or in a table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from kilter_client.errors import MissingPackageError
from kilter_client.twin.motion_step import FORMAT, TABLE
from kilter_client.twin.servo_model import ServoModel
from kilter_core.motion import GEAR_DAMPING, JointFit, JointRecord
from kilter_files.ground.later import mujoco

HARD_FRICTION = ((0.01, 1.0), (0.9999, 0.9999, 1e-6, 0.5, 2.0))  # holds to the micrometre, see the exported twin
BACKLASH_LIMITS = ((0.004, 1.0), (0.99, 0.9999, 1e-6, 0.5, 2.0))
BACKLASH_ARMATURE, BACKLASH_RATE = (
    0.02,
    10.0,
)  # of the motor's armature; 1/s, at which backlash that nothing loads comes to rest
DEGREES = 57.29577951308232
LINEAR = 1  # between samples of the past: else a delay counts in whole steps
STEP = "Call kilter.twin.apply(model, data) before every mj_step; kilter.twin.read_joints gives the readings."


@dataclass(frozen=True)
class Patched:
    """The compiled copy, its text, and what to know of it."""

    model: Any
    text: str
    notes: tuple[str, ...]


def patch_model(arm: ServoModel, records: Sequence[JointRecord], fits: Mapping[str, JointFit]) -> Patched:
    """Write a copy of a model with the servos of some joints as they were ``fits``, by name, and what these lack.

    Raises:
        MissingPackageError: a delay needs a release of MuJoCo that knows it.

    """
    spec = mujoco.MjSpec.from_file(str(arm.path))
    patch = _Patch(spec, arm, int(spec.nuserdata))
    for record in records:
        if record.name in fits:
            patch.set_joint(record, fits[record.name])
    if patch.table:
        spec.nuserdata = patch.numbers
        spec.add_text(name=TABLE, data=json.dumps({"format": FORMAT, "joints": patch.table}))
        patch.notes.append(STEP)
    if patch.joints_added:
        for key in list(spec.keys):
            patch.notes.append(
                f"Keyframe {key.name or 'without a name'} is left out: the copy has more joints than it."
            )
            spec.delete(key)
    folder = arm.path.resolve().parent
    spec.meshdir, spec.texturedir = (str(folder / part) for part in (spec.meshdir, spec.texturedir))
    return Patched(spec.compile(), spec.to_xml(), tuple(dict.fromkeys(patch.notes)))


@dataclass
class _Patch:
    """A copy as it is changed: its table for the step, and how many numbers of ``userdata`` that needs."""

    spec: Any
    arm: ServoModel
    numbers: int
    table: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    joints_added: int = 0

    def set_joint(self, record: JointRecord, fit: JointFit) -> None:
        """Set the servo of a joint, and add the effects of its fit."""
        joint = _JointPatch(self, self.arm.joints.index(record.name), record, fit)
        joint.set_servo()
        for term in fit.terms:
            getattr(joint, f"add_{term.effect.id}")(float(fit.p[term.effect.number.place]))
        if joint.row:
            stated = {"actuator": joint.actuator.name, "friction": fit.values["friction"], "slip_speed": fit.slip_speed}
            self.table[record.name] = stated | joint.row


@dataclass
class _JointPatch:
    """A joint of a copy: each effect is added as an element of MuJoCo, or as a number in the ``row`` of the table."""

    patch: _Patch
    place: int
    record: JointRecord
    fit: JointFit
    row: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def joint(self) -> Any:
        return self.patch.spec.joint(self.record.name)

    @cached_property
    def actuator(self) -> Any:
        found = self.patch.spec.actuators[self.patch.arm.actuators[self.place]]
        found.name = found.name or f"{self.record.name}_servo"
        return found

    @property
    def gear(self) -> float:
        return float(self.actuator.gear[0])

    @property
    def written_per_rad(self) -> float:
        """Units in which the source writes the angle of this joint, for each radian (m)."""
        hinge = self.joint.type == mujoco.mjtJoint.mjJNT_HINGE
        return DEGREES if self.patch.spec.compiler.degree and hinge else 1.0

    @property
    def timestep_s(self) -> float:
        return float(self.patch.arm.model.opt.timestep)

    def set_servo(self) -> None:
        values = self.fit.values
        servo = values["damping"] * values["servo_share"]
        self.joint.armature, self.joint.frictionloss = values["armature"], values["friction"]
        self.joint.damping = _as_before(self.joint.damping, values["damping"] - servo)
        self.actuator.gainprm[0] = values["gain"] / self.gear**2
        self.actuator.biasprm[1], self.actuator.biasprm[2] = -values["gain"] / self.gear**2, -servo / self.gear**2
        if not self.fit.creeps:
            self.joint.solref_friction, self.joint.solimp_friction = HARD_FRICTION
            self.patch.notes.append("Friction holds a joint without creep: solreffriction and solimpfriction are set.")

    def add_command_delay(self, size: float) -> None:
        if size <= 0.0:
            self.patch.notes.append(f"The commands of {self.record.name} act {-size * 1e3:.0f} ms before the log says.")
            return
        if not hasattr(self.actuator, "delay"):
            raise MissingPackageError("A delay needs MuJoCo 3.5: pip install --upgrade mujoco.", package="mujoco")
        self.actuator.delay, self.actuator.nsample = size, math.ceil(size / self.timestep_s) + 2
        self.actuator.interp = LINEAR
        self.patch.notes.append("The delay of a command is an element of MuJoCo 3.5 and later.")

    def add_effort_delay(self, size: float) -> None:
        length = math.ceil(size / self.timestep_s) + 3
        self.row |= {"effort_delay": size, "ring": [self._take_numbers(length), length]}

    def add_sensor_lag(self, size: float) -> None:
        self.row |= {"sensor_lag": size, "lag_at": self._take_numbers(1)}

    def _take_numbers(self, count: int) -> int:
        first = self.patch.numbers
        self.patch.numbers += count
        return first

    def add_torque_limit(self, size: float) -> None:
        limit = size / abs(self.gear)
        self.actuator.forcelimited, self.actuator.forcerange = True, [-limit, limit]

    def add_backlash(self, size: float) -> None:
        second = self._add_second_joint()
        second.armature = BACKLASH_ARMATURE * self.joint.armature
        half = 0.5 * size * self.written_per_rad
        second.limited, second.range = True, [-half, half]
        second.solref_limit, second.solimp_limit = BACKLASH_LIMITS
        second.damping = _as_before(second.damping, BACKLASH_RATE * second.armature)

    def add_flexible_gear(self, size: float) -> None:
        second = self._add_second_joint()
        bodies, motor = self.record.inertia, self.joint.armature
        both = motor * bodies / (motor + bodies)
        second.stiffness = _as_before(second.stiffness, 1.0 / size)
        second.damping = _as_before(second.damping, 2.0 * GEAR_DAMPING * math.sqrt(both / size))

    def _add_second_joint(self) -> Any:
        """A joint behind the first on the same axis: the first moves the motor, both the bodies."""
        first, name = self.joint, f"{self.record.name}_gear"
        self.patch.joints_added += 1
        sides = {key: bool(self.fit.values[key]) for key in ("servo_behind", "reads_behind")}
        self.row |= {"second": name} | sides
        return first.parent.add_joint(name=name, type=first.type, axis=list(first.axis), pos=list(first.pos))

    def add_zero_offset(self, size: float) -> None:
        self.joint.ref += size * self.written_per_rad

    def add_load_friction(self, size: float) -> None:
        self.row |= {"load_friction": size, "moving_load": bool(self.fit.values["moving_load"])}

    def add_stick(self, size: float) -> None:
        self.row["stick"] = size

    def add_reading_offset(self, size: float) -> None:
        self.row["reading_offset"] = size


def _as_before(old: Any, value: float) -> Any:
    """A damping or stiffness as this release of MuJoCo holds it: a number, or a polynomial."""
    return value if isinstance(old, float) else [value, *([0.0] * (len(old) - 1))]
