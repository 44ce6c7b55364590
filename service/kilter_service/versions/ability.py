"""Whether a version can correct the arm where it is driven, and the limits that it is stored with."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError, FindingDocument
from kilter_core.observations import evenly
from kilter_service.contract.versions import CorrectionLimits, Objection, VersionPreview
from kilter_service.ground.core import core_correct, core_identify
from kilter_service.ground.db import Database
from kilter_service.ground.wire import to_deg, to_mm
from kilter_service.versions import store, wire
from kilter_service.versions.predictions import at_pose
from kilter_service.versions.predictions.at_pose import at_poses, drawn

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.correct import Needs
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration
    from kilter_service.versions.records import PreviewedPoses


CODE, UNKNOWN = "cannot_correct", "not_foreseen"
MOST_REFUSED = 0.25  # share of the poses: a few near a singularity or at the end of the reach are to be expected
WIDEST = CorrectionLimits(max_joint_deg=30.0, max_position_mm=200.0)
TRIED = 200  # poses at which wider limits are tried
MOST_POSES = 0.99  # share of the poses that raised limits are for
SPARE = 1.2  # times the largest correction: limits to raise to
CONSTANT = 0.2  # scatter over size from which a correction is not a constant of the joint
SMALLEST_DEG, SMALLEST_MM = 0.3, 1.0  # zero offsets worth entering


@dataclass(frozen=True)
class Ability:
    """What was found: objections, remarks, and the preview in figures; None where it could not be computed."""

    objections: list[Objection] = field(default_factory=list)
    remarks: list[FindingDocument] = field(default_factory=list)
    preview: VersionPreview | None = None


def ability(database: Database, version_id: str, temperature_c: float | None) -> Ability:
    """Look at what a version does over the robot's poses, as `correct` would; a preview that fails is a remark."""
    try:
        with database.reading() as session:
            limits = CorrectionLimits(**store.get(session, version_id).limits)
            calibration = store.calibration(session, version_id)
        robot, within, found = at_pose.over_poses(database, version_id, temperature_c)
        shown = wire.preview(version_id, robot, found, within, temperature_c)
        objection = of_poses(calibration, found, limits, temperature_c)
    except (CoreError, ArithmeticError, ValueError) as error:
        message = error.message if isinstance(error, CoreError) else "the correction of some pose is not a number."
        return Ability(
            remarks=[FindingDocument.make(UNKNOWN, f"What it would correct could not be computed: {message}")]
        )
    return Ability([] if objection is None else [objection], [], shown)


def of_poses(
    calibration: Calibration, found: PreviewedPoses, limits: CorrectionLimits, temperature_c: float | None = None
) -> Objection | None:
    """What speaks against a version that refuses too many of the poses or is held at its limits there, and what helps."""
    count, refused = len(found.q), sum(found.refusal_counts.values())
    damped, limited = (found.counts.get(word, 0) for word in ("DAMPED", "LIMITED"))
    if refused + limited <= MOST_REFUSED * count:
        return None
    what = ", ".join(f"{why} {n}" for why, n in found.refusal_counts.items())
    worst = "" if found.worst is None else f"; at most {to_mm(float(found.left[found.worst])):.3g} mm are left"
    facts = (
        f"Of {count} poses that were looked at it refuses {refused}{f' ({what})' if what else ''}, {damped} are damped and "
        f"{limited} held at a limit{worst}."
    )
    return Objection(
        code=CODE, message=f"It cannot correct this arm. {facts} {_remedy(calibration, found, limits, temperature_c)}"
    )


def _remedy(
    calibration: Calibration, found: PreviewedPoses, limits: CorrectionLimits, temperature_c: float | None
) -> str:
    """What helps: zero offsets that the controller should have, and limits within which the version corrects."""
    some = evenly(len(found.q), TRIED)
    wide = at_pose.at_poses(calibration, None, WIDEST, found.q[some], temperature_c)
    if sum(wide.refusal_counts.values()) + wide.counts.get("LIMITED", 0) > MOST_REFUSED * len(some):
        return (
            f"Not even within {WIDEST.max_joint_deg:g} deg and {WIDEST.max_position_mm:g} mm would it: it describes another "
            "arm. Check the robot's description, and that joints and positions of its campaigns belong together."
        )
    asked = _limits(calibration.robot, wide, limits)
    raise_them = (
        f"raise its limits from {limits.max_joint_deg:g} deg and {limits.max_position_mm:g} mm to {asked.max_joint_deg:g} deg "
        f"and {asked.max_position_mm:g} mm (option `limits` of the job) and identify again"
    )
    zeros = _zeros(calibration, wide)
    if not zeros:
        return raise_them[0].upper() + raise_them[1:] + "."
    return (
        f"Its joints were mastered wrong: enter {'; '.join(zeros)} in the controller (the angle of the joint is its reading "
        f"plus this offset), measure and identify again. Or {raise_them}."
    )


def _limits(robot: Robot, wide: PreviewedPoses, limits: CorrectionLimits) -> CorrectionLimits:
    """Limits within which a version corrects nearly everywhere, a little more than it needs.

    What the last of a hundred poses needs is left out: near a singular posture a joint would move by 20 deg for nothing.
    """
    sliding = np.array([joint.kind == "prismatic" for joint in robot.joints])
    sizes = np.quantile(np.nan_to_num(np.abs(wide.delta)), MOST_POSES, axis=0)
    moved = float(np.quantile(np.nan_to_num(wide.moved), MOST_POSES))
    turn = to_deg(float(sizes[~sliding].max(initial=0.0)))
    shift = to_mm(max(moved, float(sizes[sliding].max(initial=0.0))))
    return CorrectionLimits(
        max_joint_deg=min(max(limits.max_joint_deg, _up(SPARE * turn)), WIDEST.max_joint_deg),
        max_position_mm=min(max(limits.max_position_mm, _up(SPARE * shift)), WIDEST.max_position_mm),
    )


def _up(value: float) -> float:
    """A number rounded up to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1) if value > 0.0 else 1.0
    return round(math.ceil(value / step) * step, 6)


def _zeros(calibration: Calibration, wide: PreviewedPoses) -> list[str]:
    """Offsets to enter, in words, of the joints whose zero is off by what is worth entering."""
    robot, out = calibration.robot, []
    for number, (joint, size) in enumerate(zip(robot.joints, _offsets(calibration, wide), strict=True), start=1):
        sliding = joint.kind == "prismatic"
        value, unit, least = (to_mm(size), "mm", SMALLEST_MM) if sliding else (to_deg(size), "deg", SMALLEST_DEG)
        if abs(value) >= least:
            out.append(f"{value:+.3g} {unit} as zero offset of joint {number} ({joint.name})")
    return out


def _offsets(calibration: Calibration, wide: PreviewedPoses) -> list[float]:
    """What each joint stands beyond its reading, rad or m: as identified, else as it is corrected everywhere alike.

    Where the zero is not a parameter of its own, other constants of the chain say it; a command less the offset then reaches
    the wanted angle at every pose.
    """
    chain, values = calibration.robot.chain, dict(zip(calibration.names, calibration.values, strict=True))
    out = []
    for k, column in zip(chain.primary, wide.delta.T, strict=True):
        element = chain.elements[k]
        own = (float(values.get(element.name or "", element.value)) - element.value) * math.copysign(1.0, element.ratio)
        moved = column[~np.isnan(column)]
        middle = float(np.median(moved)) if len(moved) else 0.0
        alike = 1.4826 * float(np.median(np.abs(moved - middle))) < CONSTANT * abs(middle) if len(moved) else False
        out.append(own or (-middle if alike else 0.0))
    return out


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
