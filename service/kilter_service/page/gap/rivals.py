"""Aliases: which effects cannot be told from the one that was named, and what would tell them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kilter_service.contract.gap_details import AliasMatrix, AtJoints, NamedEffect
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.next_poses import NextPose
from kilter_service.ground.texts import plural
from kilter_service.page.figures.heat_map import HeatMap
from kilter_service.page.shared.called import format_effect_name
from kilter_service.page.words import number, percent

MOST_LABELS = 12
CELL = 34.0
CLOSE = 0.7  # correlation from which another effect of the library is listed as near
SAME = 0.999  # two digits of the number written: "1.00"


@dataclass(frozen=True)
class Rival:
    """An effect that looks like the one that was named; ``alike``: these data cannot tell which it is."""

    name: str
    of: str
    correlation: str
    alike: bool
    wrong: str
    apart: str


def rivals(result: GapResult) -> list[Rival]:
    """Return the aliases of every named effect, then those that are merely near."""
    effects = result.effects or []
    alike = [_rival_from_alias(effect, k, result) for effect in effects for k in range(len(effect.alias_set or []))]
    known = {(rival.name, rival.of) for rival in alike}
    near = [rival for effect in effects for rival in _correlated_rivals(effect, result.alias_matrix)]
    return alike + [rival for rival in near if (rival.name, rival.of) not in known]


def _rival_from_alias(effect: NamedEffect, place: int, result: GapResult) -> Rival:
    rival = (effect.alias_set or [])[place]
    wrong = "–" if rival.p_wrong is None else percent(rival.p_wrong)
    told = [pose for pose in result.next_poses or [] if pose.information_factor is not None]
    apart = _describe_separation(told, rival.correlation)
    return Rival(format_effect_name(rival), format_effect_name(effect), number(rival.correlation), True, wrong, apart)


def _describe_separation(poses: Sequence[NextPose], correlation: float | None) -> str:
    if poses:
        changes = list(dict.fromkeys(pose.change or "measure new poses" for pose in poses))
        return f"{plural(len(poses), 'pose')} to measure next: {'; '.join(changes)}"
    if correlation is not None and correlation > SAME:
        return "They move the tool alike in these rows, and no pose that was tried tells them apart."
    return "The search proposes no pose that tells them apart."


def _correlated_rivals(effect: NamedEffect, matrix: AliasMatrix | None) -> list[Rival]:
    found = []
    for pair in (matrix.pairs if matrix is not None else None) or []:
        other = _other_of_pair(effect, pair.first, pair.second)
        if other is not None and (pair.correlation or 0.0) >= CLOSE:
            apart = "These data prefer the one named."
            found.append(
                Rival(
                    format_effect_name(other), format_effect_name(effect), number(pair.correlation), False, "–", apart
                )
            )
    return found


def _other_of_pair(effect: AtJoints, first: AtJoints, second: AtJoints) -> AtJoints | None:
    own = (effect.id, effect.joints)
    if own == (first.id, first.joints):
        return second
    return first if own == (second.id, second.joints) else None


def heat_map(matrix: AliasMatrix | None) -> HeatMap | None:
    """Draw how well signatures correlate: the effects named and their nearest; None without any."""
    labels = (matrix.labels if matrix is not None else None) or []
    values = (matrix.values if matrix is not None else None) or []
    if len(labels) < 2:
        return None
    shown = [label.replace("_", " ") for label in labels[:MOST_LABELS]]
    return HeatMap(
        "How well signatures correlate",
        shown,
        shown,
        [row[:MOST_LABELS] for row in values[:MOST_LABELS]],
        cell=CELL,
        description="1: the two move the tool alike in these rows, after the geometry is fitted; 0: not at all alike.",
    )
