"""Who is right: a claim of the finder against what was hidden."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Named = Mapping[str, Any]  # {"id", "joints"}: an effect, an alias or a hidden effect
Truth = Mapping[str, Any]  # {"effects", "background", "payload_wrong", ...}

STRONG = 30.0  # lambda from which an effect must be seen
DECIDABLE = 11.0  # lambda (1 - |rho|) from which its name must be right
TWINS = {"backlash": "friction_windup", "friction_windup": "backlash"}  # the same in any position data
CLAIMS = ("confirmed", "class_confirmed", "replicated")
STATION = ("drift", "settling", "random_walk", "base_step")  # motions of base or instrument with time: one class
SLOW = (*STATION, "thermal_drift", "column_bending", "scale_thermal")  # and those with the temperature
MOVED_AS = {
    "column_bending": {"column_bending", "thermal_drift"},
    None: {"thermal_drift"},
}  # by the truth's id: names of it
CURVES = (
    "hose_torque", "quadratic_curve", "spline_curve", "belt_error", "third_harmonic", "local_bump", "encoder_scale",
    "eccentricity", "second_harmonic", "gravity_spring",
)  # fmt: skip
WITH_TEMPERATURE = ("thermal_growth", "link_growth", "column_bending", "thermal_drift", "zero_thermal")
TWINS_OF_CLOCK = ("zero_settling", "link_lag", "link_bow", "air_scale")
BETWEEN_JOINTS = ("link_bow",)
OF_CLOCK = ("station", "thermal")  # classes that say base, station, air or arm, and so no joint
# What acts at the same place in the same way, as the generator knows it: a claim of the class holds for each of them.
KIN = {
    "joint_twist": {
        "axial_compliance",
        "hardening",
        "strain_wave",
        "direction_compliance",
        "backlash_load",
        "reading_tilt",
    },
    "joint_curve": {*CURVES, "gear_error"},
    "joint_coupling": {"joint_coupling", "sine_product"},
    "reversal": {"backlash", "friction_windup"},
    "joint_tilt": {"clearance_tilt", "radial_compliance", "base_compliance"},
    "load_sag": {"link_bending", "tool_sag"},
    "loads": {"payload_error"},
    "station": {"drift", "settling", "random_walk", "zero_drift", *WITH_TEMPERATURE, *TWINS_OF_CLOCK},
    "joint_zero": {"zero_drift", "zero_thermal", "zero_settling", "link_bow"},
    "thermal": {*WITH_TEMPERATURE, "link_lag"},
}


def empirical(said: Named) -> bool:
    """Whether a name only says that there is something, not what."""
    return str(said["id"]).startswith("unknown_")


def names(said: Named, hidden: Named) -> bool:
    """Whether a name is that of a hidden effect: id and joints. Of a family, the joints that show must be among it."""
    return bool(said["id"] == hidden["id"]) and _joints_fit(said, hidden)


def covers(effect: Named, hidden: Named) -> bool:
    """Whether a reported effect is the hidden one or lists it, or its twin in position data, among its aliases."""
    return any(names(a, hidden) for a in (effect, *effect.get("alias_set", ())))


def _joints_fit(said: Named, hidden: Named) -> bool:
    joints = said.get("joints")
    if not hidden["joints"]:
        return True
    if hidden["id"] == "joint_coupling":
        return joints is None or hidden["joints"][0] in joints
    if len(hidden["joints"]) == 1:
        return joints is not None and list(joints) == list(hidden["joints"])
    strong = {int(j) for j, lam in hidden["joint_lam"].items() if lam >= STRONG}
    return joints is None or (len(joints) > 1 and strong <= set(joints))


def named(effect: Named, hidden: Named) -> bool:
    """Whether a reported effect has a hidden one's name; a twin's name counts when the other is listed beside it."""
    if names(effect, hidden):
        return True
    twin = {**hidden, "id": TWINS.get(str(hidden["id"]), "")}
    return names(effect, twin) and covers(effect, hidden)


def right(effect: Named, truth: Truth) -> bool:
    """Whether a claim holds: a confirmed name is a hidden one's, a confirmed class holds a hidden one.

    A family found joint by joint is right at each of its joints; the class of a slow motion of base or instrument where
    they did move, and a member of it where they moved so; a wrong payload where it is wrong. Of joints that the data do
    not show nothing is claimed.
    """
    shown = effect.get("seen_joints")
    if shown and list(shown) != list(effect.get("joints") or ()):
        return _right(effect, truth) or _right({**effect, "joints": list(shown)}, truth)
    return _right(effect, truth)


def _right(effect: Named, truth: Truth) -> bool:
    hidden = truth["effects"]
    if _true_beside(effect, truth) or any(named(effect, h) or member(effect, h) for h in hidden):
        return True
    return class_claim(effect) and any(
        covers(effect, h) or member_of_class(effect, h) or _curve_of(effect, h) or _kin(effect, h) for h in hidden
    )


def _kin(effect: Named, hidden: Named) -> bool:
    """Whether the class that is claimed, and no more, holds the hidden effect, at its joint."""
    if (effect.get("claim") or {}).get("said") != "class":
        return False
    claimed = effect["physical_class"]["id"]
    if hidden["id"] not in KIN.get(claimed, set()):
        return False
    if claimed in OF_CLOCK:
        return True
    joints, true = set(effect.get("joints") or ()), set(hidden["joints"])
    if hidden["id"] in BETWEEN_JOINTS:  # the link from its joint to the next
        true |= {j + 1 for j in true}
    return not joints or not true or bool(joints & true)


def class_claim(effect: Named) -> bool:
    """Whether a class is claimed, not its head alone."""
    claimed = bool(effect.get("alias_set")) or (effect.get("claim") or {}).get("said") == "class"
    return effect["verdict"] == "class_confirmed" or (effect["verdict"] == "replicated" and claimed)


def beside_the_point(effect: Named, truth: Truth) -> bool:
    """Whether a name is true of the campaign although it is none of the hidden effects: its slow motion, its payload."""
    if truth.get("payload_wrong") and effect["id"] == "payload_error":
        return True
    return bool(truth.get("background")) and slow(effect)


def _true_beside(effect: Named, truth: Truth) -> bool:
    """Whether a claim of what is beside the point holds: where a member is claimed, it moved so."""
    if not beside_the_point(effect, truth):
        return False
    member_claimed = (effect.get("claim") or {}).get("said") == "member" and effect["id"] in SLOW
    moved = (truth.get("background") or {}).get("id")
    return not member_claimed or effect["id"] in MOVED_AS.get(moved, {moved})


def slow(effect: Named) -> bool:
    """Whether a name is that of a motion of base or instrument, or admits that it may be one."""
    return effect["id"] in SLOW or any(a["id"] in SLOW for a in effect.get("alias_set", ()))


def _curve_of(effect: Named, hidden: Named) -> bool:
    """Whether a claim says no more than that a joint errs along a smooth curve, and it does."""
    if hidden["id"] not in CURVES or list(effect.get("joints") or ()) != list(hidden["joints"]):
        return False
    said = any("smooth" in str(value) for key, value in effect.items() if "class" in key)
    return said or any(empirical(a) for a in effect.get("alias_set", ()))


def member(said: Named, hidden: Named) -> bool:
    """Whether a name is that of one joint, or of some, of a hidden family."""
    joints = set(said.get("joints") or ())
    family = said["id"] == hidden["id"] and len(hidden["joints"]) > 1
    return family and bool(joints) and joints <= set(hidden["joints"])


def member_of_class(effect: Named, hidden: Named) -> bool:
    """Whether a class holds one joint, or some, of a hidden family."""
    return any(member(a, hidden) for a in effect.get("alias_set", ()))


def sure(effects: Iterable[Named]) -> list[Named]:
    """Effects that are claimed as physics: confirmed, alone or as a class, or replicated."""
    return [e for e in effects if e["verdict"] in CLAIMS and not empirical(e)]


def found(report: Mapping[str, Any], hidden: Named) -> bool:
    """Whether the name stands in the report: in one entry, or joint by joint for a family."""
    effects = report["effects"]
    if any(named(e, hidden) for e in effects):
        return True
    members = [set(e["joints"]) for e in effects if member(e, hidden)]
    strong = {int(j) for j, lam in hidden["joint_lam"].items() if lam >= STRONG}
    return bool(members) and strong <= set().union(*members)


def said_undecidable(report: Mapping[str, Any], undecidable: Sequence[tuple[str, Sequence[int]]]) -> bool:
    """Whether a report admits that the case cannot be settled.

    Of a pair, the hidden one first: something is reported, nothing is confirmed alone, and each name that is given has
    an alias, the hidden effect among them. Of a lone effect that geometry swallows: it is listed as not testable, it is
    not named, and nothing else is confirmed.
    """
    pair: list[dict[str, Any]] = [{"id": i, "joints": list(j), "joint_lam": {}} for i, j in undecidable]
    effects = report["effects"]
    if any(e in sure(effects) and not class_claim(e) for e in effects):
        return False
    if len(pair) == 1:
        return _listed(report["not_testable"], pair[0]) and not any(named(e, pair[0]) for e in effects)
    physical = [e for e in effects if not empirical(e)]
    if not physical:
        return bool(report["verdict"] != "no_gap")
    return all(e["alias_set"] for e in physical) and any(covers(e, pair[0]) for e in physical)


def _listed(rows: Iterable[Named], hidden: Named) -> bool:
    joints = set(hidden["joints"])
    return any(u["id"] == hidden["id"] and (not u["joints"] or not joints or joints & set(u["joints"])) for u in rows)
