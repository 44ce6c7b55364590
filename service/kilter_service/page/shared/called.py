"""What people call effects, and how chances are written."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kilter_service.contract.gap_details import AtJoints, NamedEffect
from kilter_service.page.words import joined_by_and, number, of_joints

JOINT = re.compile(r"_(\d+)$")
SMALLEST_P = 1e-4


def format_effect_name(effect: AtJoints) -> str:
    """Name an effect and its joints."""
    return format_effect_at_joints(effect.id, effect.joints or [])


def format_claim(effect: NamedEffect) -> str:
    """Say what is claimed of an effect: the narrowest set that the data single out."""
    if effect.claim is None:  # an earlier result, without claims
        rivals = [format_effect_name(one) for one in effect.alias_set or []]
        return format_effect_name(effect) + (f", or its alias {joined_by_and(rivals)}" if rivals else "")
    if effect.claim.said == "member":
        return format_effect_name(effect)
    return effect.claim.words.replace("_", " ")


def format_effect_at_joints(name: str, joints: Sequence[int]) -> str:
    """Name an effect at some joints."""
    plain = name.replace("_", " ")
    if not joints:
        return plain
    return f"{plain} of {of_joints(joints)}"


def parse_joint_number(parameter: str) -> int | None:
    """Return the joint that a parameter's name ends with."""
    found = JOINT.search(parameter)
    return int(found[1]) if found else None


def chance(p: float | None) -> str:
    """Write a p-value; far below what anybody distinguishes, only its bound."""
    if p is None:
        return "–"
    return f"< {SMALLEST_P:g}" if p < SMALLEST_P else number(p, 2)
