"""A card for each effect that a search named: its clearest plot, its size, and what it passed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kilter_service.contract.gap_details import NamedEffect
from kilter_service.contract.headlines import format_joints, list_found
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.page.figures.plot import Plot
from kilter_service.page.gap.claim import RAISED
from kilter_service.page.gap.curves import curves
from kilter_service.page.shared import own_curves
from kilter_service.page.shared.called import format_effect_name, parse_joint_number

LOOKS = {"provisional": "warn", "contradicted": "bad"}
WIDE, HIGH = 620.0, 165.0


@dataclass(frozen=True)
class Chip:
    """A test in a word: ``good`` passed, ``bad`` not, ``faint`` not made; ``why`` says more."""

    name: str
    look: str
    why: str


@dataclass(frozen=True)
class Card:
    """An effect in the words of the headline; the plot is that of its clearest joint."""

    name: str
    joints: str
    level: str
    look: str
    size: str
    moves_mm: float | None
    chips: Sequence[Chip]
    rivals: Sequence[str]
    plot: Plot | None


def cards(result: GapResult, unit: str) -> list[Card]:
    """Return the cards, in the order of the answer."""
    return [_card(effect, result, unit) for effect in result.effects or []]


def _card(effect: NamedEffect, result: GapResult, unit: str) -> Card:
    amounts = sorted(effect.parameters or [], key=lambda one: abs(one.value or 0.0) / (one.sigma or 1.0), reverse=True)
    found = list_found([effect])[0]  # the words and sizes of the headline
    joint = parse_joint_number(amounts[0].name) if amounts else None
    level = (effect.verdict or "provisional").replace("_", " ")
    rivals = [format_effect_name(one) for one in effect.alias_set or []]
    look = LOOKS.get(effect.verdict or "provisional", "good")
    plot = _plot(effect, joint, result, unit)
    return Card(
        found.effect,
        format_joints(found.joints) if found.joints else "",
        level,
        look,
        found.size,
        effect.moves_mm,
        list(_chips(effect)),
        rivals,
        plot,
    )


def _plot(effect: NamedEffect, joint: int | None, result: GapResult, unit: str) -> Plot | None:
    """The effect over what it follows, at its clearest joint; else the residuals of that joint over its angle."""
    own = [
        one for one in result.effect_curves or [] if one.id == effect.id and one.joint in (effect.joints or [one.joint])
    ]
    if own:
        best = next((one for one in own if one.joint == joint), own[0])
        return own_curves.plot(best, WIDE, HIGH)
    drawn = curves(result.figures, unit, WIDE, HIGH)
    found = next((one for one in drawn if one.joint == joint), None)
    return None if found is None else found.plot


def _chips(effect: NamedEffect) -> Iterator[Chip]:
    gates = effect.gates.model_dump() if effect.gates is not None else {}
    yield _chip("held-out", gates.get("held_out"), "Held-out poses gain by it")
    named = sum(effect.halves.named or []) if effect.halves is not None else None
    yield _chip("halves", None if named is None else named == 2, "Each half of the campaign names it")
    yield _chip("shuffles", gates.get("negative_control"), "It vanishes when its labels are shuffled")
    outcome = effect.replication.outcome if effect.replication is not None else None
    again = {"replicated": True, "contradicted": False, "not_seen": False}.get(outcome or "")
    evidence = (effect.claim.evidence if effect.claim is not None else None) or []
    lacking = [one.words for one in evidence if not one.met and one.words]
    if evidence:
        yield _chip("second load", None if lacking else True, "; ".join(lacking) or "Told from its class")
    yield _chip("another day", again, "Seen again in a campaign of another day or set-up")


def _chip(name: str, passed: bool | None, why: str) -> Chip:
    return Chip(name, "faint" if passed is None else "good" if passed else "bad", why)


def describe_decision(result: GapResult) -> str:
    """Say what would decide what is open; empty where nothing would."""
    told = result.told_apart
    if told is not None and told.instead and not told.enough:
        instead = "; ".join(told.instead).replace("_", " ")
        many = f"about {told.poses_needed}" if told.poses_needed else "more than 1000"
        return f"{instead[:1].upper()}{instead[1:]}. Poses alone would not do: {many} are needed."
    if told is not None and told.sentence:
        return told.sentence
    wanted = list(dict.fromkeys(one for effect in result.effects or [] for one in effect.to_confirm or []))
    if wanted:
        return " ".join(wanted[:2])
    poses = result.next_poses or []
    changes = list(dict.fromkeys(pose.change or "new poses" for pose in poses))
    if poses:
        return f"{len(poses)} poses: {'; '.join(changes[:3])}."
    levels = {effect.verdict for effect in result.effects or []}
    return next((RAISED[level] for level in ("class_confirmed", "confirmed") if level in levels), "")
