"""What people call effects, versions and parameters, and how chances are written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from kilter_core.errors import CoreError
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.fits import Parameter
from kilter_service.contract.gap_details import AtJoints, NamedEffect
from kilter_service.contract.versions import Objection
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.jobs import service as jobs
from kilter_service.page.figures import drawn as strip
from kilter_service.page.words import joined_by_and, number, of_joints, parameter_sigma
from kilter_service.versions import service as versions

STEMS = ("link_mass_", "link_moment_", "load_payload_")


def of_a_mass(name: str) -> bool:
    """Whether a parameter is an error of a mass or a centre, as `load_error` names them."""
    return name.startswith(STEMS)


ID = re.compile(r"(?:\b[Vv]ersion )?\b(ver|cmp|job)_[0-9a-f]{16}\b")
KINDS: Mapping[str, Callable[[Database, str], Any]] = {
    "ver": versions.get,
    "cmp": campaigns.get,
    "job": jobs.get,
}


def in_names(database: Database, text: str) -> str:
    """Write names for the ids of a sentence; of what is gone the id stays."""

    def name(found: re.Match[str]) -> str:
        before, _, what = found[0].rpartition(" ")
        try:
            said = display_name(KINDS[found[1]](database, what))
        except CoreError:
            return found[0]
        return said if not before or said.startswith("version ") else f"{before} {said}"

    return ID.sub(name, text)


def objections_in_names(database: Database, found: list[Objection]) -> list[Objection]:
    """Return objections whose sentences name by names."""
    return [one.model_copy(update={"message": in_names(database, one.message)}) for one in found]


def version_name(database: Database, version: str | None) -> str:
    """Return the name of a version, what it is where it has none, its id where it is gone; empty: the nominal robot."""
    if not version:
        return ""
    try:
        return display_name(versions.get(database, version))
    except ServiceError:
        return version


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


TWO = 1.96  # standard deviations of an end of a 95 % interval
CARRIED = 0.7  # of what was known before: rows that leave a wider interval say less of it than was known


@dataclass(frozen=True)
class ParameterRow:
    """A parameter and its drawing, which is empty where nothing says how sure it is, or what was known before.

    ``carried``: the rows say more of it than was known.
    """

    parameter: Parameter
    drawn: Markup | str
    carried: bool


def parameter_rows(parameters: Sequence[Parameter], priors: Mapping[str, float]) -> list[ParameterRow]:
    """Return the rows, sorted by change over standard deviation."""
    ordered = sorted(parameters, key=lambda one: -_clearness(one))
    return [ParameterRow(one, _draw(one, prior := priors.get(one.name)), _is_carried(one, prior)) for one in ordered]


def _is_carried(one: Parameter, prior: float | None) -> bool:
    sigma = parameter_sigma(one)
    return not sigma or not prior or one.lower is not None or sigma < CARRIED * prior


def _clearness(one: Parameter) -> float:
    sigma = parameter_sigma(one)
    return 0.0 if one.change is None else abs(one.change) / sigma if sigma else math.inf


def _draw(one: Parameter, prior: float | None) -> Markup | str:
    sigma = parameter_sigma(one)
    if one.change is None or one.value is None or not sigma or not prior:
        return ""
    nominal = one.value - one.change
    low = one.change - TWO * sigma if one.lower is None else one.lower - nominal
    high = one.change + TWO * sigma if one.upper is None else one.upper - nominal
    title = f"{one.name}: {_clearness(one):.1f} standard deviations from nominal; the band is what was known before"
    return strip.against_prior(one.change, low, high, prior, title)
