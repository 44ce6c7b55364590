"""What stands at the head of a twin for a simulator: what each effect is worth, where it went, and how good the twin is.

What no element of MuJoCo is, as a table for the step in Python (``kilter.twin.apply``), SI.

Which effects of a version elements of MuJoCo can be, which a step in Python adds, and which neither holds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.arm import (
    BendingRow,
    Conditions,
    Curve,
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
from kilter_core.model import acts_at_rest, workspace
from kilter_core.types import Floats
from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.contract.versions import Version
from kilter_service.robots.exporters.exportable import displacements_mm

if TYPE_CHECKING:
    from kilter_core.effects import Effect
    from kilter_core.model import Calibration


ROUNDS = 30  # until an arm hangs where its own loads say
SAID_UM = 0.01


Placed = Sequence[tuple[str, Sequence["Effect"]]]  # where effects went, in words, and those that went there


def notes(version: Version, calibration: Calibration, placed: Placed, known: Sequence[str]) -> tuple[str, ...]:
    """Everything to know before the twin is trusted; ``known`` is what all twins of the format have in common."""
    effects = _of_effects(calibration, placed)
    loads = (*_of_loads(calibration), *_of_soft_base(calibration))
    masses = version.details.masses
    taken = () if masses is None or masses.sentence is None else (masses.sentence,)
    return (*effects, *loads, *taken, held_out(version.metrics.validation), *known)


def in_mujoco(exported: ExportedEffects) -> Placed:
    """Where the effects went in a model of MuJoCo."""
    return (
        ("In the model", exported.in_elements),
        ("In the model, and of some joints added by the step in Python (kilter.twin.apply) only", exported.in_both),
        ("Added by the step in Python (kilter.twin.apply) only", exported.in_step),
        ("Left out", exported.left_out),
    )


def of_sharpened(exported: ExportedEffects) -> tuple[str, ...]:
    """Which joints change their side at once here, and over a load in a prediction."""
    if not exported.sharpened:
        return ()
    names = ", ".join(f"{name} {width:g} N m" for name, width in exported.sharpened)
    told = "The side of a backlash changes at once; a prediction lets it change over a load"
    return (f"{told} ({names}), so where less than three times that loads the joint the two may differ.",)


KNOWN_OF_MUJOCO = (
    "Controls are the readings of the controller, in rad and m. Set what the tool carries by the mass of the body payload, "
    "then call mj_setConst.",
    "A joint that nothing loads rests anywhere within its backlash, and where friction holds it depends on how it came there.",
    "Not calibrated: inertia of the drives, damping, speed and torque limits. The twin is true where it has settled.",
)


def held_out(errors: StageErrors | None) -> str:
    """How far the arm was from each model at poses that no fit has seen."""
    if errors is None or errors.identified is None:
        return "No measured poses were held out: how good the twin is where it was not fitted is not known."
    models = (
        ("nominal", errors.registration_only),
        ("rigid, calibrated", errors.best_rigid),
        ("with the effects", errors.identified),
    )
    said = ", ".join(f"{name} {_mm(found)}" for name, found in models if found is not None)
    return f"Held-out measured poses ({errors.n}), mean error of the tool, base and tool fitted: {said}."


def _mm(errors: Errors) -> str:
    return f"{errors.mean_mm:.4f} mm"


def _of_effects(calibration: Calibration, placed: Placed) -> Iterator[str]:
    sizes = displacements_mm(calibration)
    for where, effects in placed:
        yield from _effect_notes(where, effects, sizes)


def _effect_notes(where: str, effects: Sequence[Effect], sizes: dict[str, tuple[float, float]]) -> Iterator[str]:
    for effect in effects:
        size = sizes.get(effect.id)
        if size is None:
            yield f"{where}: {effect.id}, which acts with {', '.join(sorted(effect.needs - {'moments'}))}."
        else:
            worth = f"{size[0] * 1e3:.1f} um rms and {size[1] * 1e3:.1f} um at most over the workspace, without load"
            yield f"{where}: {effect.id}, worth {worth}."


def _of_loads(calibration: Calibration) -> Iterator[str]:
    """How far the arm that hangs is from a prediction: one of a version without its own loads takes them at the readings."""
    kept = calibration.with_effects([effect for effect in calibration.model.effects if acts_at_rest(effect)])
    if not any("moments" in effect.needs for effect in kept.model.effects):
        return
    rows = workspace(calibration.robot)
    chain = kept.model.load_chain
    plain = kept.model if chain is None else replace(kept.model, load_chain=replace(chain, effects=None))
    told, hanging = kept.predict(rows), plain.batch(rows)
    for _ in range(ROUNDS):
        where = plain.link_angles(hanging, kept.values)
        hanging = replace(plain.batch(replace(rows, q=where)), q=rows.q)
    apart = np.linalg.norm(plain.predict(hanging, kept.values).position - told.position, axis=1) * 1e6
    if apart.max() > SAID_UM:
        at_readings = chain is None or not chain.effects
        takes = "takes the loads at the readings" if at_readings else "takes a side where nothing loads a backlash"
        yield (
            f"The twin hangs where its loads leave it, a prediction of Kilter {takes}: "
            f"{np.sqrt(np.mean(apart**2)):.2f} um rms and {apart.max():.2f} um at most apart over the workspace."
        )


def _of_soft_base(calibration: Calibration) -> Iterator[str]:
    """How far gravity is tilted against the arm, which a prediction leaves out of its loads and a simulator does not."""
    kept = calibration.with_effects([effect for effect in calibration.model.effects if effect.id == "base_compliance"])
    if not kept.model.effects:
        return
    batch, (soft, where) = kept.model.batch(workspace(calibration.robot)), kept.model.effects_with_slices[0]
    moved = soft.local(batch, kept.values[where]).base
    tilt = 0.0 if moved is None else float(np.max(np.linalg.norm(moved[:, 3:], axis=1)))
    if tilt > 0.0:
        yield (
            f"The soft base tilts by up to {np.degrees(tilt):.2g} deg over the workspace, without load: where a simulator has "
            "it, gravity loads the tilted arm; a prediction of Kilter leaves gravity as the robot states it, and sag and the "
            "side of a backlash with it."
        )


FORMAT = 1


def table(form: RunTimeForm) -> str | None:
    """Write the table as JSON; None where elements hold everything."""
    names = [joint.name for joint in form.robot.joints]
    joints = {name: _joint(joint) for name, joint in zip(names, form.joints, strict=True)}
    curves = [_curve(curve, names) for curve in form.curves if curve.shape is not Shape.LAG]
    bending = [_bending(row, names) for row in form.bending]
    left = {name: own for name, own in joints.items() if own}
    if not (left or curves or bending):
        return None
    twists = {names[j]: form.joints[j].twist.tolist() for j in sorted(twisting(form))}
    whole = {"joints": left, "twists": twists, "curves": curves, "bending": bending}
    return json.dumps({"format": FORMAT, "order": names} | whole)


def twisting(form: RunTimeForm) -> set[int]:
    """Joints behind which the step moves a body."""
    curved = {curve.joint for curve in form.curves if curve.twist is not None}
    bent = {row.joint for row in form.bending}
    tilted = {j for j, joint in enumerate(form.joints) if joint.tilt != 0.0 or joint.radial_compliance != 0.0}
    return curved | bent | tilted


def _joint(joint: JointForm) -> dict[str, Any]:
    """The numbers of a joint beyond what elements have of it."""
    own = passive_joint_part(joint)
    more: dict[str, Any] = {name: getattr(joint, name) for name in BY_THE_STEP if getattr(joint, name) != 0.0}
    if joint.tilt != 0.0:
        more |= {"tilt_by_vector": joint.tilt_by_vector, "tilt_softening_nm": joint.tilt_softening_nm}
    for name in ("compliance", "reversal", "backlash"):
        if getattr(joint, name) != getattr(own, name):
            more[name] = getattr(joint, name)
    if "backlash" in more:
        more["backlash_softening_nm"] = joint.backlash_softening_nm
    return more


def _curve(curve: Curve, names: list[str]) -> dict[str, Any]:
    return {
        "joint": names[curve.joint],
        "shape": curve.shape.name.lower(),
        "driver": names[curve.driver],
        "a": curve.a,
        "b": curve.b,
        "factor": curve.factor,
        "constants": list(curve.constants),
        "powers": list(curve.powers),
        "twist": curve.twist,
    }


def _bending(row: BendingRow, names: list[str]) -> dict[str, Any]:
    return {
        "joint": names[row.joint],
        "of_joint": row.of_joint.tolist(),
        "of_end": row.of_end.tolist(),
        "link": row.link.tolist(),
        "reach": list(row.reach),
    }


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
