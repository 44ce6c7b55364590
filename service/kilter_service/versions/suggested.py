"""The limits that a version is stored with: what it needs all over the joint limits of its robot, not a constant."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_correct, core_identify
from kilter_service.ground.wire import to_deg, to_mm
from kilter_service.versions.predictions.at_pose import at_poses, drawn

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.correct import Needs
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration

STEP_DEG, STEP_MM = 0.5, 1.0  # to which limits are rounded up
# An arm without a wrong zero offset, base or tool is not so far from its drawing: beyond, somebody has to say so himself.
MOST_MM = 10.0
COVERED = 0.99  # of the poses, as in kilter_core.correct.needs
WORKSPACE = "workspace"  # in the report of a version


def suggest_limits(
    calibration: Calibration, known: Predictive | None, asked: CorrectionLimits
) -> tuple[CorrectionLimits, dict[str, Any]]:
    """Return the limits for a version, and what its report says of them (mm, degrees). What was ``asked`` for stays."""
    q = drawn(calibration.robot)
    found = core_correct.needs(calibration, q)
    shift = to_mm(max(found.largest_m, found.farthest_m))
    own = {
        "max_joint_deg": _rounded_up(to_deg(found.largest_rad), STEP_DEG),
        "max_position_mm": min(_rounded_up(shift, STEP_MM), MOST_MM),
    }
    given = asked.model_fields_set & set(own)
    limits = CorrectionLimits(**(asked.model_dump() | own | asked.model_dump(include=given)))
    turn_deg, shift_mm = _needed_corrections(calibration.robot, found)
    there = at_poses(calibration, known, limits, q)
    return limits, {
        "poses": len(q),
        "reach_mm": to_mm(core_identify.reach(calibration.robot)),
        "needed_deg": turn_deg,
        "needed_mm": shift_mm,
        "ok": there.counts.get("OK", 0) + there.counts.get("UNSURE", 0),
        "damped": there.counts.get("DAMPED", 0),
        "limited": there.counts.get("LIMITED", 0),
        "refused": there.refusal_counts,
        "sentence": _sentence(
            f"{turn_deg:.2g} deg and {shift_mm:.2g} mm", limits, given, len(q), found.capped or shift > MOST_MM
        ),
    }


def _needed_corrections(robot: Robot, found: Needs) -> tuple[float, float]:
    """What most of the poses take at most: of a revolute joint, degrees; of the tool or a prismatic joint, mm."""
    joints = list(zip(robot.joints, found.joints[COVERED].tolist(), strict=True))
    turn = max((size for joint, size in joints if joint.kind == "revolute"), default=0.0)
    slide = max((size for joint, size in joints if joint.kind != "revolute"), default=0.0)
    return to_deg(turn), to_mm(max(found.removed[COVERED], slide))


def _rounded_up(size: float, step: float) -> float:
    return step * math.ceil(size / step - 1e-9)


def _sentence(need: str, limits: CorrectionLimits, given: set[str], poses: int, capped: bool) -> str:
    """Say why the limits are what they are."""
    what = f"Needs at most {need} at {100 * COVERED:.0f} % of {poses} poses all over the joint limits"
    set_to = f"limits {limits.max_joint_deg:g} deg and {limits.max_position_mm:g} mm"
    if given:
        return f"{what}; {set_to}, as asked for."
    if capped:
        return (
            f"{what}; {set_to}: more is not set unasked. Look for a wrong zero offset, base or tool first; if it is right, "
            "give limits when identifying."
        )
    return f"{what}; {set_to}."
