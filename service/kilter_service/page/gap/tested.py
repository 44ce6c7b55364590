"""Which candidates were tested: named, refused or not testable, with the reason of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from kilter_service.contract.gap_details import AtJoints, Detectable, NamedEffect, Refused, Untestable
from kilter_service.contract.jobs.gap import GapOptions, GapResult
from kilter_service.page.shared.called import chance, format_effect_at_joints, format_effect_name, parse_joint_number
from kilter_service.page.words import joined_by_and, number, percent

MIMICKED = 0.1  # share of a signature that geometry leaves, below which it is said to imitate it


@dataclass(frozen=True)
class Candidate:
    """A candidate of the search and what became of it."""

    name: str
    outcome: str
    look: str
    reason: str


def candidates(result: GapResult, options: GapOptions, unit: str) -> list[Candidate]:
    """Return those named, their rivals, those refused."""
    return [*_named_candidates(result.effects or [], unit), *_refused_candidates(result, options)]


def _named_candidates(effects: Sequence[NamedEffect], unit: str) -> Iterator[Candidate]:
    for effect in effects:
        gain = _gain(effect.gain_mm, unit)
        level = (effect.verdict or "").replace("_", " ")
        look = "warn" if effect.verdict in ("provisional", "contradicted") else "good"
        yield Candidate(
            format_effect_name(effect),
            f"named, {level}",
            look,
            f"{gain}p {chance(effect.p_value)} that chance does as much",
        )
        for rival in effect.alias_set or []:
            behind = f"{number(rival.behind, 2)} points behind, " if rival.behind else "does as well, "
            reason = (
                f"{behind}its signature correlates {number(rival.correlation, 2)} with {format_effect_name(effect)}"
            )
            yield Candidate(format_effect_name(rival), "cannot be told apart", "warn", reason)


def _gain(gain: float | None, unit: str) -> str:
    """What an effect takes off the plain rms error, or that it takes off the weighed one only."""
    if gain is None:
        return ""
    if gain < 0.0:
        return f"explains the surer readings better, and adds {number(-gain)} {unit} to the plain rms error; "
    return f"takes {number(gain)} {unit} off the rms error; "


def _refused_candidates(result: GapResult, options: GapOptions) -> Iterator[Candidate]:
    effects = result.effects or []
    known: list[AtJoints] = [*effects, *(rival for effect in effects for rival in effect.alias_set or [])]
    taken: set[tuple[str, int | None]] = {(one.id, None) for one in known if not one.joints}
    taken |= {(one.id, joint) for one in known for joint in one.joints or []}
    rest = [one for one in result.smallest_detectable or [] if _key(one) not in taken]
    scores: dict[tuple[str, int | None], Refused] = {}
    for one in result.refused or []:
        scores |= {(one.id, joint): one for joint in (one.joints or (None,))}
    for key, group in groupby(sorted(rest, key=lambda d: (d.id, parse_joint_number(d.parameter or "") or 0)), key=_key):
        yield _candidate(list(group), effects, options, scores.get(key))


def _key(one: Detectable) -> tuple[str, int | None]:
    return one.id, parse_joint_number(one.parameter or "")


def _candidate(
    group: list[Detectable], effects: Sequence[NamedEffect], options: GapOptions, score: Refused | None
) -> Candidate:
    name, joint = _key(group[0])
    seen = "; ".join(
        f"{number(one.smallest_detectable, 2)}{'' if one.unit in (None, '1') else f' {one.unit}'} of {one.parameter or name}"
        for one in group
    )
    rest = f" beside {joined_by_and([format_effect_name(effect) for effect in effects])}" if effects else ""
    reason = f"{_refusal_reason(score, options, _names(effects))}{rest}; would be seen from {seen}"
    share = max((one.visibility or 0.0) for one in group)
    if share < MIMICKED:
        reason += f"; geometry imitates {percent(1 - share)} of it"
    return Candidate(format_effect_at_joints(name, [joint] if joint else []), "refused", "faint", reason)


def _names(effects: Sequence[NamedEffect]) -> int:
    """How many names those are of the number allowed: an effect at several joints is one, a shape each of its joints."""
    return len({(one.id, tuple(one.joints or ()) if one.empirical else ()) for one in effects})


def _refusal_reason(score: Refused | None, options: GapOptions, named: int) -> str:
    """Why a candidate was not named, by its score at the final fit."""
    if score is None or score.p_value is None or score.explains is None:
        return "explains nothing of its own"
    said = f"explains {number(100 * score.explains, 2)} % of what is left, p {chance(score.p_value)}"
    if score.p_value > options.alpha:
        return f"no better than chance: {said}"
    if named >= options.max_effects:
        return f"{said}, but no more effects than {options.max_effects} were asked for"
    return f"{said}, but has not the sign or size of such an effect, or does not keep it when all is fitted again"


def untestable(rows: Sequence[Untestable]) -> dict[str, list[tuple[str, str, str]]]:
    """Return what these rows cannot say, by what is missing: the effect, why, and what would help; equal reasons together."""
    found: dict[tuple[str, str, str, str], list[int]] = {}
    for row in rows:
        key = (row.missing or row.reason or "", row.id, row.reason or "", row.remedy or "")
        found.setdefault(key, []).extend(row.joints or [])
    groups: dict[str, list[tuple[str, str, str]]] = {}
    for (missing, name, reason, remedy), joints in found.items():
        groups.setdefault(missing, []).append((format_effect_at_joints(name, joints), reason, remedy))
    return groups
