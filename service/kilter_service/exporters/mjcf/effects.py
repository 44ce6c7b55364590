"""Which effects of a version elements of MuJoCo can be, which a step in Python adds, and which neither holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from kilter_core.arm.loads.slopes import with_masses, with_payload
from kilter_core.arm.robot import Payload, Robot
from kilter_core.arm.run_time import Conditions, JointForm, RunTimeForm, Shape
from kilter_core.effects import Effect

if TYPE_CHECKING:
    from kilter_core.model import Calibration, RobotModel
    from kilter_core.types import Floats

BY_THE_STEP = ("tilt", "radial_compliance", "hardening", "compliance_by_direction")


@dataclass(frozen=True)
class ExportedEffects:
    """What the effects do at rest, the arm as it weighs, and the effects by where they went."""

    form: RunTimeForm
    robot: Robot
    payload: Payload
    in_elements: tuple[Effect, ...]
    in_step: tuple[Effect, ...]
    left_out: tuple[Effect, ...]


def exported_effects(calibration: Calibration) -> ExportedEffects:
    """Sort the effects of the arm; those of the instrument are none of it."""
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    load = model.robot.load or Payload(0.0)
    form = RunTimeForm.empty(model.load_robot, Conditions(load.mass))
    sorted_out: dict[str, list[Effect]] = {"elements": [], "step": [], "nowhere": []}
    for effect, at in model.placed:
        if effect.stage != "measurement":
            sorted_out[_place(effect, values[at], model, load)].append(effect)
            effect.at_run_time(form, values[at])
    weighed = model.load_robot
    if form.link_errors is not None:
        weighed = with_masses(weighed, form.link_errors.tolist())
    mass, com = with_payload(load.mass, load.com, form.payload_errors.tolist())
    return ExportedEffects(
        form, weighed, Payload(mass, (com[0], com[1], com[2])), *(tuple(found) for found in sorted_out.values())
    )


def _place(effect: Effect, values: Floats, model: RobotModel, load: Payload) -> str:
    """Where an effect goes that is alone. What follows a payload follows the one that the robot carries."""
    if "payload_kg" in effect.needs and load.mass <= 0.0:
        return "nowhere"
    form = RunTimeForm.empty(model.load_robot, Conditions(load.mass))
    if not effect.at_run_time(form, values) or any(curve.shape is Shape.LAG for curve in form.curves):
        return "nowhere"
    return "step" if form.curves or form.bending or any(_needs_the_step(joint) for joint in form.joints) else "elements"


def _needs_the_step(joint: JointForm) -> bool:
    return any(getattr(joint, name) != 0.0 for name in BY_THE_STEP) or joint != elements_of(joint)


def elements_of(joint: JointForm) -> JointForm:
    """The part of what a joint does that a spring, friction and a hinge with limits are: none of them pushes."""
    part = replace(joint, tilt_by_vector=False, tilt_softening_nm=0.0)
    for name in BY_THE_STEP:
        setattr(part, name, 0.0)
    part.compliance = max(joint.compliance, 0.0)
    part.reversal = min(joint.reversal, 0.0)
    if joint.backlash < 0.0 or joint.backlash_softening_nm > 0.0:
        part.backlash = part.backlash_softening_nm = 0.0
    return part
