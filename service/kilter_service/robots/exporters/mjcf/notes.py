"""What stands at the head of a twin for a simulator: what each effect is worth, where it went, and how good the twin is.

What no element of MuJoCo is, as a table for the step in Python (``kilter.twin.apply``), SI.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.arm import BendingRow, Curve, JointForm, RunTimeForm, Shape
from kilter_core.model import acts_at_rest, workspace
from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.contract.versions import Version
from kilter_service.robots.exporters.exportable import displacements_mm
from kilter_service.robots.exporters.mjcf.effects import BY_THE_STEP, ExportedEffects, passive_joint_part

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
