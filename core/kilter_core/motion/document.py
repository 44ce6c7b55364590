"""What a search in torques found as a document: effects as a search in poses names them, and torques joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kilter_core.effects.physical import joint_numbers
from kilter_core.motion.effects import MOTION_EFFECTS, prismatic_unit
from kilter_core.motion.find import MotionReport
from kilter_core.motion.layout import Term
from kilter_core.motion.search import Judged
from kilter_core.types import QUANTILE, Floats

SCRAMBLED_SHARE = 0.25  # of all torque; joints without a signal have little
ALIKE = 1.5  # times the least of some factors: they are one
# Times too large or too small, at one joint or at half of them: no masses are described so wrongly.
FAR, ALL_FAR = 10.0, 3.0
MIXED = 40.0  # times between two joints: the side of a gear; masses that stand in for unknown ones may differ by less
FEWEST_LATE = 3  # joints, from which a common delay is that of a clock
IMITATED = "masses, inertias and friction of the model make the same torques in this log"


def to_document(report: MotionReport) -> dict[str, Any]:
    """Return the document; joints count from 1, angles are in rad as in URDF and MJCF."""
    units = ["N m" if joint.kind == "revolute" else "N" for joint in report.robot.joints]
    joints = [
        {
            "joint": j + 1,
            "unit": units[j],
            "rigid": float(report.held.rigid[j]),
            "friction": float(report.held.common[j]),
            "found": float(report.held.found[j]),
            "clipped_rows": report.clipped[j],
            "at_rest": j in report.resting,
        }
        for j in range(report.robot.n_joints)
    ]
    clock = _find_clock(report)
    judged = () if clock is not None or report.without_mean or _is_scrambled(report) else report.judged
    friction = [one for term, value in report.common for one in _list_amplitudes(term, value, None, units)]
    friction += [
        amplitude for one in report.faint for amplitude in _list_amplitudes(one.term, one.value, one.sigma, units)
    ]
    return {
        "verdict": "provisional" if any(one.verdict == "provisional" for one in judged) else "not_known",
        "effects": [_describe_effect(one, units) for one in judged],
        "motion": {
            "joints": joints,
            "friction": friction,
            "motions": report.motions,
            "seconds": report.seconds,
            "unseen": report.unseen,
            "base_parameters": len(report.base),
            "model": report.model.to_document(),
        },
        "not_testable": [
            {"id": t.effect.id, "joints": [t.joint + 1], "reason": IMITATED, "remedy": f"Record {t.effect.remedy}."}
            for t in report.hidden
        ],
        "warnings": [*([] if clock is None else [clock]), *_describe_faint(report.faint), *_list_warnings(report)],
    }


def _describe_faint(faint: Sequence[Judged]) -> Iterator[dict[str, Any]]:
    """Say which effects that were fitted, because somebody asked for them, do not show."""
    for effect in dict.fromkeys(one.term.effect for one in faint):
        joints = [one.term.joint for one in faint if one.term.effect is effect]
        message = (
            f"{effect.label[0].upper()}{effect.label[1:]} does not show at {joint_numbers(joints)} in this log: zero is as "
            f"likely. Leave it out there, or record {effect.remedy}."
        )
        yield {"code": "effect_not_shown", "message": message, "joints": [j + 1 for j in joints]}


def _find_clock(report: MotionReport) -> dict[str, Any] | None:
    """Say that torques come late at most joints alike: that is their clock, and hides what else there is."""
    late = [one for one in report.judged if one.term.effect.id == "torque_delay"]
    moving = report.robot.n_joints - len(report.resting)
    if 2 * len(late) <= moving or moving < FEWEST_LATE:
        return None
    delay = float(np.median([one.value[0] for one in late]))
    message = (
        f"Torques come {abs(delay):.3f} s {'after' if delay > 0.0 else 'before'} the positions at {len(late)} of {moving} "
        "joints: they have another clock. Shift their times and upload the log again; nothing else was named."
    )
    return {"code": "torque_clock", "message": message, "delay_s": delay}


def _is_scrambled(report: MotionReport) -> bool:
    """Whether so much torque is not explained that the order of the joints, a sign or a unit must be another, or whether
    joints have different units: bodies would be none.
    """
    odd, scale = list(report.unexplained), np.abs(report.scale[np.isfinite(report.scale)])
    mixed = len(scale) > 1 and scale.max() > MIXED * scale.min()
    return bool(mixed or report.spread[odd].sum() > SCRAMBLED_SHARE * report.spread.sum())


def _describe_effect(one: Judged, units: list[str]) -> dict[str, Any]:
    effect, j = one.term.effect, one.term.joint
    return {
        "id": effect.id,
        "joints": [j + 1],
        "session": one.term.session,
        "seen_joints": [j + 1],
        "verdict": one.verdict,
        "empirical": False,
        "claim": None,
        "physical_class": effect.describe_class(effect.physical.label_for_joints([j]), MOTION_EFFECTS),
        "class": effect.physical.label_for_joints([j]) if one.verdict == "class_confirmed" else None,
        "alias_set": [
            {"id": rival.term.effect.id, "joints": [rival.term.joint + 1], "behind": rival.behind}
            for rival in one.rivals
        ],
        "parameters": list(_list_amplitudes(one.term, one.value, one.sigma, units)),
        "held_out_gain": {
            "gain": None,
            "standard_error": None,
            "deviations": one.unseen / max(one.unseen_sigma, 1e-12),
        },
        "to_confirm": [] if one.verdict in ("confirmed", "replicated") else [f"record {effect.remedy}."],
    }


def _list_amplitudes(term: Term, value: Floats, sigma: Floats | None, units: list[str]) -> list[dict[str, Any]]:
    found = []
    for k, (name, unit) in enumerate(term.effect.parameters):
        unit = unit if units[term.joint] == "N m" else prismatic_unit(unit)
        spread = None if sigma is None else float(sigma[k])
        found.append(
            {
                "name": f"{term.effect.id}_{name}_{term.joint + 1}",
                "value": float(value[k]),
                "unit": unit,
                "sigma": spread,
                "interval_low": None if spread is None else float(value[k]) - QUANTILE * spread,
                "interval_high": None if spread is None else float(value[k]) + QUANTILE * spread,
                "seen": None if spread is None else bool(np.abs(value[k]) > QUANTILE * spread),
            }
        )
    return found


def _describe_scale(report: MotionReport) -> Iterator[dict[str, Any]]:
    """Say where torques are far from what the described masses need: in another unit, or on the motor's side."""
    known = np.flatnonzero(np.isfinite(report.scale))
    off = np.abs(np.log(np.abs(report.scale[known])))
    many = len(known) > 1 and np.median(off) > np.log(ALL_FAR)
    far = known[off > np.log(ALL_FAR if many else FAR)]
    if not len(far):
        return
    found = [float(f"{report.scale[j]:.2g}") for j in far.tolist()]
    each = ", ".join(f"{times:g} (joint {j + 1})" for times, j in zip(found, far.tolist(), strict=True))
    alike = max(found) < ALIKE * min(found)
    message = (
        f"Torques are {f'{np.median(found):g}' if alike else 'so many'} times what the described masses need: "
        f"{joint_numbers(far.tolist()) if alike else each}. Compare unit (N m), torque constant and side of "
        "the gear, and give a scale in a column map; or correct the masses. Until then kg and N m are in the log's unit."
    )
    yield {"code": "torque_unit", "message": message, "joints": [j + 1 for j in far.tolist()]}


def _list_warnings(report: MotionReport) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    if not report.unseen:
        message = (
            "All rows are one motion, so nothing here was judged by a motion that no choice saw. Record two more and give "
            "each its own session, or leave a gap in t_s between them."
        )
        found.append({"code": "one_motion", "message": message})
    if report.resting:
        named = ", ".join(str(j + 1) for j in report.resting)
        message = f"Joints {named} do not move in this log: nothing is said of them. Record a motion of them too."
        found.append({"code": "joints_at_rest", "message": message, "joints": [j + 1 for j in report.resting]})
    if report.without_mean:
        message = (
            "No motion of this log has a mean torque at any joint: it was taken off, or a filter did, and gravity with it. "
            "Log the torques or currents as they are; nothing was named."
        )
        found.append({"code": "torque_mean", "message": message})
    found += _describe_scale(report)
    odd = [j + 1 for j in report.unexplained]
    if odd:
        nothing = "" if _is_scrambled(report) else " of them"
        message = (
            f"The model explains little of the torque of joints {', '.join(map(str, odd))}. Compare the order and the signs of "
            "the joints, the unit and the side of the gear with the robot's description; a base that moved does it, too. "
            f"Nothing{nothing} was named."
        )
        found.append({"code": "torques_unexplained", "message": message, "joints": odd})
    if report.pushed_s:
        first = ", ".join(f"{one:.0f}" for one in report.pushed_s[:4])
        message = (
            f"Something leant on the arm for {len(report.pushed_s)} s, first at t_s {first}: the torques are far beyond all "
            "others there, and were left out. Record it anew without contact if these seconds matter."
        )
        found.append({"code": "log_pushed", "message": message})
    clipped = [j + 1 for j, rows in enumerate(report.clipped) if rows]
    if clipped:
        message = (
            f"{sum(report.clipped)} torques of joints {', '.join(map(str, clipped))} stand at the largest of the log for "
            "several rows: the drive gave no more. They were left out; record slower motions."
        )
        found.append({"code": "torque_clipped", "message": message, "joints": clipped})
    return found
