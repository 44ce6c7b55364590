"""Which effects of a version elements of MuJoCo can be, which a step in Python adds, and which neither holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.arm import (
    Conditions,
    JointForm,
    Payload,
    Robot,
    RunTimeForm,
    Shape,
    axial_loads,
    joint_loads,
    with_masses,
    with_payload,
)
from kilter_core.effects import Effect
from kilter_core.model import workspace
from kilter_core.types import Floats

if TYPE_CHECKING:
    from kilter_core.model import Calibration


# Share of a joint's largest load over which its side may change and still be taken as changing at once: where a joint
# carries three such widths, a seventh of what it carries at most, the two are within half a per cent.
SHARP = 0.05
BY_THE_STEP = ("tilt", "radial_compliance", "hardening", "compliance_by_direction")


@dataclass(frozen=True)
class ExportedEffects:
    """What the effects do at rest, the arm as it weighs, and the effects by where they went.

    ``in_both`` are those that elements hold of some joints only; ``sharpened`` the joints whose side changes at once here,
    with the load, N m (N), over which it does in a prediction.
    """

    form: RunTimeForm
    robot: Robot
    payload: Payload
    in_elements: tuple[Effect, ...]
    in_both: tuple[Effect, ...]
    in_step: tuple[Effect, ...]
    left_out: tuple[Effect, ...]
    beyond_drives: tuple[Effect, ...]  # of those in elements: what needs more than a frame, a mass and a gain
    sharpened: tuple[tuple[str, float], ...]


def exported_effects(calibration: Calibration) -> ExportedEffects:
    """Sort the effects of the arm; those of the instrument are none of it."""
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    load = model.robot.load or Payload(0.0)
    form = RunTimeForm.empty(model.load_robot, Conditions(load.mass))
    sorted_out: dict[str, list[Effect]] = {"elements": [], "both": [], "step": [], "nowhere": []}
    beyond, loads = [], largest_loads(model.load_robot)
    for effect, at in model.effects_with_slices:
        if effect.stage != "measurement":
            alone = RunTimeForm.empty(model.load_robot, Conditions(load.mass))
            place = _place(effect, values[at], load, alone, loads)
            sorted_out[place].append(effect)
            if place in ("elements", "both") and _beyond_a_drive(alone):
                beyond.append(effect)
            effect.at_run_time(form, values[at])
    weighed = model.load_robot
    if form.link_errors is not None:
        weighed = with_masses(weighed, form.link_errors.tolist())
    mass, com = with_payload(load.mass, load.com, form.payload_errors.tolist())
    sharpened = _sharpen_backlash(form, loads)
    elements, both, step, nowhere, past = (tuple(found) for found in (*sorted_out.values(), beyond))
    carried = Payload(mass, (com[0], com[1], com[2]))
    return ExportedEffects(form, weighed, carried, elements, both, step, nowhere, past, sharpened)


def _sharpen_backlash(form: RunTimeForm, loads: Floats) -> tuple[tuple[str, float], ...]:
    """Let sides that change over little of the largest load (n,) change at once, as those of a hinge with limits do."""
    found = []
    for joint, own, load in zip(form.robot.joints, form.joints, loads, strict=True):
        if own.backlash > 0.0 and 0.0 < own.backlash_softening_nm <= SHARP * load:
            found.append((joint.name, own.backlash_softening_nm))
            own.backlash_softening_nm = 0.0
    return tuple(found)


def _place(effect: Effect, values: Floats, load: Payload, form: RunTimeForm, loads: Floats) -> str:
    """Where an effect goes, alone in ``form``. What follows a payload follows the one that the robot carries."""
    if "payload_kg" in effect.needs and load.mass <= 0.0:
        return "nowhere"
    if not effect.at_run_time(form, values) or any(curve.shape is Shape.LAG for curve in form.curves):
        return "nowhere"
    _sharpen_backlash(form, loads)
    if not (form.curves or form.bending or any(_needs_the_step(joint) for joint in form.joints)):
        return "elements"
    held = any(part.compliance or part.reversal or part.backlash for part in map(passive_joint_part, form.joints))
    return "both" if held else "step"


def _beyond_a_drive(form: RunTimeForm) -> bool:
    moving = any(joint.reversal != 0.0 or joint.backlash != 0.0 for joint in form.joints)
    return moving or any(c != 0.0 for c in form.base_compliance or ())


def _needs_the_step(joint: JointForm) -> bool:
    return any(getattr(joint, name) != 0.0 for name in BY_THE_STEP) or joint != passive_joint_part(joint)


def passive_joint_part(joint: JointForm) -> JointForm:
    """The part of what a joint does that a spring, friction and a hinge with limits are: none of them pushes."""
    part = replace(joint, tilt_by_vector=False, tilt_softening_nm=0.0)
    for name in BY_THE_STEP:
        setattr(part, name, 0.0)
    part.compliance = max(joint.compliance, 0.0)
    part.reversal = min(joint.reversal, 0.0)
    if joint.backlash < 0.0 or joint.backlash_softening_nm > 0.0:
        part.backlash = part.backlash_softening_nm = 0.0
    return part


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
