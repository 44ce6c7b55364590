"""What is claimed of each effect: a card with its clearest plot, the tests behind the claim, and its rivals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_service.contract.figures import NextPose
from kilter_service.contract.gap_details import AliasMatrix, AtJoints, Evidence, Halves, NamedEffect, Replication
from kilter_service.contract.headlines import format_joints, list_found
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.ground.naming import plural
from kilter_service.page.figures.drawn import HeatMap
from kilter_service.page.figures.plot import Plot
from kilter_service.page.shared import curves
from kilter_service.page.shared.naming import chance, format_claim, format_effect_name, parse_joint_number
from kilter_service.page.words import joined_by_and, number, percent

LEVELS: Mapping[str, str] = {
    "contradicted": "Rows that took no part in the search err more with it: it is left out of the version.",
    "provisional": "Likely, but a test was not passed.",
    "class_confirmed": "Every test was passed, but these data cannot tell which member of its class it is.",
    "confirmed": "Every test was passed, on poses that took no part in the search.",
    "replicated": "Every test was passed, and what is claimed was seen again in a campaign of another day or set-up.",
}
OUTCOMES: Mapping[str, str] = {
    "replicated": "It was seen again with the same amplitude.",
    "contradicted": "It is contradicted there.",
    "not_seen": "It does not stand out there.",
    "other_size": "It has another size there, and predicts better all the same.",
    "not_testable": "It cannot be tested there.",
}
RAISED = {
    "class_confirmed": "Tell it from its class: measure what its name needs and the poses asked for, or look at the joint.",
    "confirmed": "Measure a campaign on another day, with the instrument set up anew, and take it in as a confirmation.",
    "replicated": "This is the highest level.",
}
Say = Callable[[Evidence], str]


def _shape(evidence: Evidence) -> str:
    if evidence.bumped:
        return "a local bump of the joint does as well"
    return _fill("the best such curve is {number} points behind", evidence.no_empirical_alias)


def _fill(said: str, value: float | None) -> str:
    """Write a value into what is said of it."""
    if value is None:
        return "no number"
    return said.format(number=number(value, 2), percent=percent(value), poses=plural(round(value), "pose"))


def _plausible(evidence: Evidence) -> str:
    far = evidence.plausible
    within = far is not None and far <= 0
    return "within" if within else _fill("{number} standard deviations beyond what is plausible", far)


# What each test says where it was passed, and what decided: a sentence of the number of its name, or more than that.
GATES: Mapping[str, tuple[str, Say | str]] = {
    "physical": ("It is a cause, not only a shape", lambda e: "a cause" if e.physical else "a shape"),
    "adequate": ("With it the model agrees with the measurements", lambda e: f"p = {chance(e.adequate)}"),
    "lasts": (
        "It lasts: nothing else is left, or halves of the campaign or a confirmation bear it out all the same",
        lambda e: f"p of the whole model = {chance(e.adequate)}",
    ),
    "held_out": ("Held-out poses gain by it", "{number} standard deviations; more than 3 are needed"),
    "unseen_poses": ("Poses that took no part in the search judged it", "{poses}"),
    "no_empirical_alias": ("No curve without a cause does as well", _shape),
    "plausible": ("Its amplitude is plausible for an arm", _plausible),
    "seen": (
        "Its amplitude differs from zero",
        lambda e: "zero is outside" if e.seen else "zero is inside its interval",
    ),
    "inclusion": ("It is named again on resampled poses", "in {percent} of the resamples"),
    "negative_control": ("It vanishes when its labels are shuffled", "still named in {percent} of the shuffles"),
    "sensor": ("A sensor at the place shows it", "in {number} standard deviations"),
    "complete_geometry": (
        "No rotation that the robot's description lacks does as well",
        lambda e: "the description lacks some",
    ),
    "confirmation": ("The confirmation does not contradict it", "amplitudes {number} standard deviations apart"),
}


@dataclass(frozen=True)
class Claim:
    """What is claimed of an effect."""

    name: str
    level: str
    means: str
    tests: list[dict[str, Any]]  # a test by ``name``, whether it was ``passed``, and the ``number`` that decided
    raise_it: list[str]
    remarks: list[str]


def claim_from_effect(effect: NamedEffect, unit: str = "mm") -> Claim:
    """Say how sure an effect is; ``unit`` is that of the search's lengths."""
    level = effect.verdict or "provisional"
    higher = list(effect.to_confirm or []) or [RAISED[level]] if level in RAISED else list(effect.to_confirm or [])
    remarks = list(_remarks(effect, unit))
    return Claim(format_claim(effect), level, LEVELS.get(level, ""), list(_tests(effect)), higher, remarks)


def describe_evidence(name: str, evidence: Evidence) -> str:
    """Say by what number a test was decided."""
    _, say = GATES[name]
    return _fill(say, getattr(evidence, name)) if isinstance(say, str) else say(evidence)


def _tests(effect: NamedEffect) -> Iterator[dict[str, Any]]:
    gates = effect.gates.model_dump() if effect.gates is not None else {}
    evidence = effect.evidence or Evidence()
    for name, (words, _) in GATES.items():
        if gates.get(name) is not None:
            yield {"name": words, "passed": bool(gates[name]), "number": describe_evidence(name, evidence)}


def _remarks(effect: NamedEffect, unit: str) -> Iterator[str]:
    unseen = sorted(set(effect.joints or []) - set(effect.seen_joints or effect.joints or []))
    if unseen:
        yield f"Not seen at joint {', '.join(map(str, unseen))}: zero is within the interval there."
    if effect.too_small_to_matter:
        yield f"It moves the tool by {number((effect.moves_mm or 0.0) * 1e3, 2)} µm: too small to matter."
    yield from _class(effect)
    told = [
        one.told for one in (effect.claim.evidence if effect.claim is not None else None) or [] if one.met and one.told
    ]
    yield from (f"{words[:1].upper()}{words[1:]}." for words in told)
    if effect.empirical:
        yield "It is a shape without a cause: never take it for physics."
    if effect.halves is not None:
        yield _halves(effect.halves, effect.joints or [], unit)
    if effect.replication is not None:
        yield _replication(effect.replication, unit)


def _class(effect: NamedEffect) -> Iterator[str]:
    """What else it may be, and what would name it."""
    if effect.physical_class is None or effect.claim is None:
        if effect.class_:
            yield f"It stands for its class: {effect.class_}."
        return
    if effect.claim.said != "class":
        return
    members = [one.replace("_", " ") for one in effect.physical_class.members or []]
    yield f"It may be any of its class: {joined_by_and([*members, *(effect.physical_class.outside or [])])}."
    lacking = [one.words for one in effect.claim.evidence or [] if not one.met and one.words]
    if lacking:
        yield f"A name inside the class needs {joined_by_and(lacking)}."


def _halves(told: Halves, joints: Sequence[int], unit: str) -> str:
    """What the halves of the campaign say, with both errors, and at which of several joints they agree."""
    named = sum(told.named or [])
    both = (
        ""
        if told.with_mm is None
        else f", and predicts the other with {number(told.with_mm, 3)} {unit} (without it "
        f"{number(told.without_mm, 3)} {unit})"
    )
    where = ""
    if told.joints is not None and len(joints) > 1:
        at = f"at joint {', '.join(map(str, told.joints))}" if told.joints else "at the same joint nowhere"
        where = f" Both name it {at}."
    return (
        f"Something else is left, so each half of the campaign was asked: {named} of 2 name it{both}; the amplitudes are "
        f"{number(told.apart_sigma, 2)} standard deviations apart.{where}"
    )


def _replication(told: Replication, unit: str) -> str:
    apart = "" if told.apart_sigma is None else f" ({number(told.apart_sigma, 2)} standard deviations apart)"
    said = OUTCOMES.get(told.outcome or "", "").removesuffix(".")
    both = (
        ""
        if told.with_mm is None
        else f" {number(told.with_mm, 3)} {unit} with it, {number(told.without_mm, 3)} {unit} without it."
    )
    return f"In the confirmation: {said[:1].lower()}{said[1:]}{apart}. {told.reason or ''}".rstrip() + both


LOOKS = {"provisional": "warn", "contradicted": "bad"}
WIDE, HIGH = 620.0, 165.0


def cards(result: GapResult, unit: str) -> list[dict[str, Any]]:
    """Return a card for each effect in the words of the headline; the plot is that of its clearest joint."""
    return [_card(effect, result, unit) for effect in result.effects or []]


def _card(effect: NamedEffect, result: GapResult, unit: str) -> dict[str, Any]:
    amounts = sorted(effect.parameters or [], key=lambda one: abs(one.value or 0.0) / (one.sigma or 1.0), reverse=True)
    found = list_found([effect])[0]  # the words and sizes of the headline
    level = effect.verdict or "provisional"
    return {
        "name": found.effect,
        "joints": format_joints(found.joints) if found.joints else "",
        "level": level.replace("_", " "),
        "look": LOOKS.get(level, "good"),
        "size": found.size,
        "moves_mm": effect.moves_mm,
        "chips": list(_chips(effect)),
        "rivals": [format_effect_name(one) for one in effect.alias_set or []],
        "plot": _plot(effect, parse_joint_number(amounts[0].name) if amounts else None, result, unit),
    }


def _plot(effect: NamedEffect, joint: int | None, result: GapResult, unit: str) -> Plot | None:
    """The effect over what it follows, at its clearest joint; else the residuals of that joint over its angle."""
    own = [
        one for one in result.effect_curves or [] if one.id == effect.id and one.joint in (effect.joints or [one.joint])
    ]
    if own:
        best = next((one for one in own if one.joint == joint), own[0])
        return curves.plot(best, WIDE, HIGH)
    drawn = curves.curves(result.figures, unit, WIDE, HIGH)
    found = next((one for one in drawn if one.joint == joint), None)
    return None if found is None else found.plot


def _chips(effect: NamedEffect) -> Iterator[dict[str, str]]:
    """Yield tests in a word each: the look is ``good`` where it was passed, ``bad`` where not, ``faint`` where not made."""
    gates = effect.gates.model_dump() if effect.gates is not None else {}
    named = sum(effect.halves.named or []) if effect.halves is not None else None
    outcome = effect.replication.outcome if effect.replication is not None else None
    evidence = (effect.claim.evidence if effect.claim is not None else None) or []
    lacking = [one.words for one in evidence if not one.met and one.words]
    found: list[tuple[str, bool | None, str]] = [
        ("held-out", gates.get("held_out"), "Held-out poses gain by it"),
        ("halves", None if named is None else named == 2, "Each half of the campaign names it"),
        ("shuffles", gates.get("negative_control"), "It vanishes when its labels are shuffled"),
    ]
    if evidence:
        found.append(("second load", None if lacking else True, "; ".join(lacking) or "Told from its class"))
    again = {"replicated": True, "contradicted": False, "not_seen": False}.get(outcome or "")
    found.append(("another day", again, "Seen again in a campaign of another day or set-up"))
    for name, passed, why in found:
        yield {"name": name, "look": "faint" if passed is None else "good" if passed else "bad", "why": why}


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


MOST_LABELS = 12
CELL = 34.0
CLOSE = 0.7  # correlation from which another effect of the library is listed as near
SAME = 0.999  # two digits of the number written: "1.00"


def rivals(result: GapResult) -> list[dict[str, Any]]:
    """Return the aliases of every named effect, then those that are merely near; ``alike``: these data cannot tell which."""
    told = [pose for pose in result.next_poses or [] if pose.information_factor is not None]
    alike, near = [], []
    for effect in result.effects or []:
        name = format_effect_name(effect)
        for rival in effect.alias_set or []:
            wrong = "–" if rival.p_wrong is None else percent(rival.p_wrong)
            apart = _describe_separation(told, rival.correlation)
            alike.append(_rival(rival, name, rival.correlation, alike=True, wrong=wrong, apart=apart))
        for pair in (result.alias_matrix.pairs if result.alias_matrix is not None else None) or []:
            other = _other_of_pair(effect, pair.first, pair.second)
            if other is not None and (pair.correlation or 0.0) >= CLOSE:
                near.append(_rival(other, name, pair.correlation, apart="These data prefer the one named."))
    known = {(one["name"], one["of"]) for one in alike}
    return alike + [one for one in near if (one["name"], one["of"]) not in known]


def _rival(
    rival: AtJoints, of: str, correlation: float | None, apart: str, alike: bool = False, wrong: str = "–"
) -> dict[str, Any]:
    said = {"name": format_effect_name(rival), "of": of, "correlation": number(correlation)}
    return {**said, "alike": alike, "wrong": wrong, "apart": apart}


def _describe_separation(poses: Sequence[NextPose], correlation: float | None) -> str:
    if poses:
        changes = list(dict.fromkeys(pose.change or "measure new poses" for pose in poses))
        return f"{plural(len(poses), 'pose')} to measure next: {'; '.join(changes)}"
    if correlation is not None and correlation > SAME:
        return "They move the tool alike in these rows, and no pose that was tried tells them apart."
    return "The search proposes no pose that tells them apart."


def _other_of_pair(effect: NamedEffect, first: AtJoints, second: AtJoints) -> AtJoints | None:
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
