"""What no element of MuJoCo is, as a table for the step in Python (``kilter.twin.apply``), SI."""

from __future__ import annotations

import json
from typing import Any

from kilter_core.arm import BendingRow, Curve, JointForm, RunTimeForm, Shape
from kilter_service.robots.exporters.mjcf.effects import BY_THE_STEP, passive_joint_part

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
