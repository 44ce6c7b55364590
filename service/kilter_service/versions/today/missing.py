"""The newest gap search against what the active version corrects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from kilter_service.contract.gap_details import AtJoints, NamedEffect
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.today import NamedMissing, SearchToday
from kilter_service.contract.written import as_written
from kilter_service.versions.today.store import Active, Searched


def against(found: Searched, active: Active | None) -> SearchToday:
    """Say what a search named, which of it the active version corrects, and what is missing now."""
    result = as_written(GapResult, {key: value for key, value in found.result.items() if key != "figures"})
    named = [_missing_from_effect(one, () if active is None else active.effects) for one in result.effects or []]
    return SearchToday(
        job_id=found.job_id,
        at=found.at,
        campaigns=found.campaigns,
        start=result.start,
        verdict=result.verdict,
        named=named,
        open=_open(result),
        next_poses=len(result.next_poses or []),
        sentence=_sentence(found, result, named, active),
    )


def format_claim(effect: NamedEffect) -> str:
    """Name an effect; where these data cannot tell it from others of its class, the class or all of them."""
    if effect.claim is not None and effect.claim.said != "member":
        return effect.claim.words.replace("_", " ")
    rivals = (
        [_format_effect_at_joints(one.id, one.joints or []) for one in effect.alias_set or []]
        if _is_undecided(effect)
        else []
    )
    names = list(dict.fromkeys([_format_effect_at_joints(effect.id, effect.joints or []), *rivals]))
    return names[0] if len(names) == 1 else f"{' or '.join(names)} (these data cannot tell)"


def _is_undecided(effect: NamedEffect) -> bool:
    return effect.verdict in ("class_confirmed", "provisional", "contradicted") or effect.class_ is not None


def _format_effect_at_joints(name: str, joints: Sequence[int]) -> str:
    words = name.replace("_", " ")
    return words if not joints else f"{words} of joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}"


def _missing_from_effect(effect: NamedEffect, corrected: Iterable[dict[str, Any]]) -> NamedMissing:
    joints = set(effect.joints or [])
    alike: list[AtJoints] = [effect, *((effect.alias_set or []) if _is_undecided(effect) else [])]
    there = any(one.get("id") == like.id and set(like.joints or []) <= _joints(one, set(like.joints or []))
                for one in corrected for like in alike)  # fmt: skip
    return NamedMissing(id=effect.id, joints=sorted(joints), words=format_claim(effect), corrected=there)


def _joints(effect: dict[str, Any], wanted: set[int]) -> set[int]:
    """Joints of an effect of a version; one that states none is of all."""
    stated = effect.get("joints")
    return wanted if stated is None else set(stated)


def _open(result: GapResult) -> str:
    """What a search leaves unsettled."""
    unsure = [format_claim(one) for one in result.effects or [] if one.verdict == "provisional"]
    said = ["something is left that no known effect explains"] if result.verdict == "unexplained" else []
    said += [f"not yet confirmed: {', '.join(unsure)}"] if unsure else []
    return "; ".join(said) or "nothing that these data show"


def _sentence(found: Searched, result: GapResult, named: Sequence[NamedMissing], active: Active | None) -> str:
    when = f"the search of {found.at:%Y-%m-%d}"
    lacking = [one.words for one in named if not one.corrected]
    there = [one.words for one in named if one.corrected]
    beyond = " Something is left that no known effect explains." if result.verdict == "unexplained" else ""
    if not named:
        return (result.sentence or "Nothing was named.") + f" So said {when}."
    if active is None:
        return f"No version is active, so nothing is corrected of what {when} named: {', '.join(lacking)}.{beyond}"
    has = f"The active version corrects {', '.join(there)}, which {when} named." if there else ""
    if not lacking:
        return f"{has} Nothing else is known to be missing.{beyond}" if not beyond else f"{has}{beyond}"
    lack = f"Missing in the active version: {', '.join(lacking)}, which {when} named."
    return f"{lack} {has}".strip() + beyond
