"""What a search in commands and readings found: a document with a headline, and the ranges of all numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from kilter_core.motion.effects import prismatic_unit
from kilter_core.motion.rollout.effects import ROLLOUT_EFFECTS, RolloutEffect
from kilter_core.motion.rollout.find import Absorbed, RolloutReport, list_absorbed
from kilter_core.motion.rollout.record import JointRecord
from kilter_core.motion.rollout.search import JointFindings, JudgedEffect, covariance, servo_has_own_scale, servo_sigmas
from kilter_core.parameters import FittedNumber, draw_ranges
from kilter_core.types import QUANTILE

EDGE = {  # SI -> factor and unit at the edge
    "s": (1e3, "ms"),
    "rad": (float(np.degrees(1.0)), "deg"),
    "1": (100.0, "%"),
    "N m": (1.0, "N m"),
    "rad/(N m)": (float(np.degrees(1.0)), "deg/(N m)"),
}
OF_SLIDES = {"rad": (1e3, "mm"), "N m": (1.0, "N"), "rad/(N m)": (1e3, "mm/N")}
SURE = {"replicated": "certain", "confirmed": "certain", "class_confirmed": "certain", "provisional": "probable"}
LOOSE = 0.3  # of a number of the servo, that its standard error may be
MUCH = 1.2  # times, from which a number that had absorbed an effect is worth saying


def describe_rollouts(report: RolloutReport) -> dict[str, Any]:
    """Return the document; angles in deg, delays in ms, shares in %, numbers of the servo in SI as MJCF has them."""
    effects = [_describe_effect(found, one) for found in report.joints for one in found.judged]
    return {
        "headline": write_headline(report),
        "verdict": "found" if effects else "no_gap",
        "effects": effects,
        "joints": [_describe_joint(found) for found in report.joints],
        "excluded": [  # what a log leaves room for; what it leaves all room for is not testable
            {
                "id": effect.id,
                "joint": found.record.name,
                "at_most": _edge(found, effect, limit)[0],
                "unit": _edge(found, effect, limit)[1],
            }
            for found in report.joints
            for effect, limit in found.excluded
            if limit < effect.number.high
        ],
        "episodes": report.episodes,
        "held_out_episodes": list(report.held_episodes),
        "seconds": report.seconds,
        "warnings": _list_warnings(report),
    }


def write_headline(report: RolloutReport) -> str:
    """Say what was found, what it leaves, and what a fit without it makes of the servo."""
    certain = _name_effects(report, "certain")
    probable = _name_effects(report, "probable")
    said = [f"Found: {certain}." if certain else "Found nothing that the model's joints lack."]
    if probable:
        said.append(f"Probable: {probable}.")
    count = len(report.held_episodes)
    where = f"{count} unseen episode{'s' if count > 1 else ''}" if report.unseen else "the last third of the log"
    stated, base, found = (_overall_rms(report, which) for which in ("stated", "base", "fit"))
    last = "" if not (certain or probable) else f", with what was found {found:.2g} deg"
    said.append(
        f"Error on {where}: your model {stated:.2g} deg, with numbers of the servo fitted {base:.2g} deg{last}."
    )
    worst = [
        (one.times, f"{one.number.name} of {found.record.name} {one.times:.1f} times")
        for found in report.joints
        if found.judged
        for one in list_absorbed(found)
        if one.times > MUCH
    ]
    if worst:
        listed = ", ".join(text for _, text in sorted(worst, reverse=True)[:3])
        said.append(f"A fit without it makes {listed} too large.")
    return " ".join(said)


def _name_effects(report: RolloutReport, how_sure: str) -> str:
    return ", ".join(
        f"{_label(one)} of {found.record.name} ({_size(found, one)})"
        for found in report.joints
        for one in found.judged
        if SURE.get(one.verdict) == how_sure
    )


def _label(one: JudgedEffect) -> str:
    """Plain name: of the class where another member does as well."""
    return one.term.effect.physical.label.replace(" of {joint}", "") if one.rivals else one.term.effect.label


def _size(found: JointFindings, one: JudgedEffect) -> str:
    value, unit = _edge(found, one.term.effect, one.value)
    return f"{value:.3g} {unit}"


def _edge(found: JointFindings, effect: RolloutEffect, value: float) -> tuple[float, str]:
    units = EDGE | (OF_SLIDES if found.record.slides else {})
    factor, unit = units[effect.number.unit]
    return float(value) * factor, unit


def _overall_rms(report: RolloutReport, which: str) -> float:
    """Root mean square in deg over all revolute joints, on rows that no choice saw."""
    squares = [_rms_of(found, which) ** 2 for found in report.joints if not found.record.slides]
    return EDGE["rad"][0] * float(np.sqrt(np.mean(squares))) if squares else 0.0


def _rms_of(found: JointFindings, which: str) -> float:
    if which == "stated":
        rows = found.split.held & found.record.used
        return float(np.sqrt(np.mean(found.stated_left[rows] ** 2)))
    return found.rms(found.base if which == "base" else found.believed)


def _describe_joint(found: JointFindings) -> dict[str, Any]:
    factor, unit = (EDGE | (OF_SLIDES if found.record.slides else {}))["rad"]
    sigmas = servo_sigmas(found.record, found.believed, found.split.train)
    return {
        "joint": found.record.name,
        "unit": unit,
        "stated": factor * _rms_of(found, "stated"),
        "servo_fitted": factor * _rms_of(found, "base"),
        "found": factor * _rms_of(found, "fit"),
        "friction": "as the simulator has it" if found.believed.creeps else "holds without creep",
        "servo": [_describe_absorbed(found, one, sigmas[one.number.name]) for one in list_absorbed(found)],
        "set_aside": [{"episode": episode, "t_s": t} for episode, t in found.pushed_s],
    }


def _describe_absorbed(found: JointFindings, one: Absorbed, sigma: float) -> dict[str, Any]:
    unit = one.number.unit
    return {
        "name": one.number.name,
        "unit": prismatic_unit(unit) if found.record.slides else unit,
        "stated": float(found.record.stated[one.number.place]),
        "without_effects": one.without,
        "found": one.found,
        "interval_low": max(one.found - QUANTILE * sigma, 0.0),
        "interval_high": one.found + QUANTILE * sigma,
        "absorbed": one.times if found.judged else None,
    }


def _describe_effect(found: JointFindings, one: JudgedEffect) -> dict[str, Any]:
    effect = one.term.effect
    value, unit = _edge(found, effect, one.value)
    sigma = abs(_edge(found, effect, one.sigma)[0])
    return {
        "id": effect.id,
        "joint": found.record.name,
        "label": f"{_label(one)} of {found.record.name}",
        "verdict": one.verdict,
        "sure": SURE.get(one.verdict),
        "variant": one.term.variant,
        "physical_class": effect.describe_class(effect.physical.label.format(joint=found.record.name), ROLLOUT_EFFECTS),
        "alias_set": [rival.id for rival in one.rivals],
        "parameters": [
            {
                "name": effect.number.name,
                "value": value,
                "unit": unit,
                "sigma": sigma,
                "interval_low": value - QUANTILE * sigma,
                "interval_high": value + QUANTILE * sigma,
            }
        ],
        "unseen_deviations": one.unseen,
        "each_log": one.each_log,
        "to_confirm": [] if SURE.get(one.verdict) == "certain" and not one.rivals else [f"Record {effect.remedy}."],
    }


def _list_warnings(report: RolloutReport) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    loose = [
        f"{number} of {one.record.name}"
        for one in report.joints
        for number, sigma in servo_sigmas(one.record, one.believed, one.split.train).items()
        if sigma > LOOSE * one.believed.values[number]
    ]
    if loose:
        message = (
            f"This log hardly says {', '.join(loose)}: the copy has what your model states, or nearly. "
            "Record faster motions."
        )
        found.append({"code": "servo_loose", "message": message})
    scaled = [one.record.name for one in report.joints if not servo_has_own_scale(one)]
    if scaled:
        message = (
            f"Of {', '.join(scaled)} the log says the ratios of armature, friction, damping and gain. Their scale is that "
            "of the inertia that your model gives the bodies there: check it, or let a weight load the joint."
        )
        found.append({"code": "servo_scale", "message": message, "joints": scaled})
    if not report.unseen:
        message = "All rows are one episode, so no whole episode has judged. Record two more."
        found.append({"code": "one_episode", "message": message})
    if report.resting:
        message = f"{', '.join(report.resting)} hardly move: nothing is said of them. Record a motion of them too."
        found.append({"code": "joints_at_rest", "message": message, "joints": list(report.resting)})
    aside = [(one.record.name, one.pushed_s) for one in report.joints if one.pushed_s]
    if aside:
        named = ", ".join(f"{len(seconds)} s at {name}" for name, seconds in aside)
        message = (
            f"Something leant on the arm for {named}: these seconds were left out. Record them anew without contact."
        )
        found.append({"code": "log_pushed", "message": message})
    return found


def draw_joint_ranges(joints: Sequence[JointFindings], level: float = 0.95, seed: int = 0) -> dict[str, Any]:
    """Return ranges at a ``level`` of each number of each joint, and draws of all of them, in SI as MJCF has them.

    Numbers of one joint are drawn together, from the covariance of their fit with each second as one observation; numbers
    that cannot be negative are drawn as their logarithms. ``readings`` say within what the readings of a joint that was
    drawn lie about the simulated ones, as often as the level says, on rows that no choice saw.
    """
    numbers, spreads, readings = [], [], {}
    for found in joints:
        fit, record = found.believed, found.record
        for number, name in zip(fit.fitted, fit.names, strict=True):
            own = _name_in_joint(record, name, number.unit)
            value = float(fit.p[number.place])
            numbers.append(replace(own, value=value, log=number.scale == "log", low=number.low, high=number.high))
        scales = np.where([number.scale == "log" for number in fit.fitted], 1.0, fit.scales)
        spreads.append(covariance(record, fit, found.split.train) * np.outer(scales, scales))
        left = np.abs(fit.left[found.split.held & record.used])
        readings[_name_in_joint(record, "reading_within", "rad").key] = float(np.quantile(left, level))
    return draw_ranges(numbers, np.asarray(block_diag(*spreads)), level, seed=seed) | {"readings": readings}


def _name_in_joint(record: JointRecord, name: str, unit: str) -> FittedNumber:
    return FittedNumber(f"{record.name}.{name}", prismatic_unit(unit) if record.slides else unit, 0.0)
