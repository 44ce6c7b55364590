"""How sure a named effect is, in plain words: the level of the claim, the tests behind it, what would raise it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from kilter_service.contract.gap_details import Evidence, Halves, NamedEffect, Replication
from kilter_service.ground.texts import plural
from kilter_service.page.shared.called import chance, format_claim
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


def _format_or_missing(value: float | None, write: Callable[[float], str]) -> str:
    return "no number" if value is None else write(value)


def _shape(evidence: Evidence) -> str:
    if evidence.bumped:
        return "a local bump of the joint does as well"
    return _format_or_missing(
        evidence.no_empirical_alias, lambda v: f"the best such curve is {number(v, 2)} points behind"
    )


GATES: Mapping[str, tuple[str, Say]] = {
    "physical": ("It is a cause, not only a shape", lambda e: "a cause" if e.physical else "a shape"),
    "adequate": ("With it the model agrees with the measurements", lambda e: f"p = {chance(e.adequate)}"),
    "lasts": (
        "It lasts: nothing else is left, or halves of the campaign or a confirmation bear it out all the same",
        lambda e: f"p of the whole model = {chance(e.adequate)}",
    ),
    "held_out": (
        "Held-out poses gain by it",
        lambda e: _format_or_missing(
            e.held_out, lambda v: f"{number(v, 2)} standard deviations; more than 3 are needed"
        ),
    ),
    "unseen_poses": (
        "Poses that took no part in the search judged it",
        lambda e: _format_or_missing(e.unseen_poses, lambda v: plural(round(v), "pose")),
    ),
    "no_empirical_alias": ("No curve without a cause does as well", _shape),
    "plausible": (
        "Its amplitude is plausible for an arm",
        lambda e: _format_or_missing(
            e.plausible,
            lambda v: "within" if v <= 0 else f"{number(v, 2)} standard deviations beyond what is plausible",
        ),
    ),
    "seen": (
        "Its amplitude differs from zero",
        lambda e: "zero is outside" if e.seen else "zero is inside its interval",
    ),
    "inclusion": (
        "It is named again on resampled poses",
        lambda e: _format_or_missing(e.inclusion, lambda v: f"in {percent(v)} of the resamples"),
    ),
    "negative_control": (
        "It vanishes when its labels are shuffled",
        lambda e: _format_or_missing(e.negative_control, lambda v: f"still named in {percent(v)} of the shuffles"),
    ),
    "sensor": (
        "A sensor at the place shows it",
        lambda e: _format_or_missing(e.sensor, lambda v: f"in {number(v, 2)} standard deviations"),
    ),
    "complete_geometry": (
        "No rotation that the robot's description lacks does as well",
        lambda e: "the description lacks some",
    ),
    "confirmation": (
        "The confirmation does not contradict it",
        lambda e: _format_or_missing(e.confirmation, lambda v: f"amplitudes {number(v, 2)} standard deviations apart"),
    ),
}


@dataclass(frozen=True)
class Test:
    """A test of an effect: whether it was passed, and the number that decided."""

    name: str
    passed: bool
    number: str


@dataclass(frozen=True)
class Claim:
    """What is claimed of an effect."""

    name: str
    level: str
    means: str
    tests: list[Test]
    raise_it: list[str]
    remarks: list[str]


def claim_from_effect(effect: NamedEffect, unit: str = "mm") -> Claim:
    """Say how sure an effect is; ``unit`` is that of the search's lengths."""
    level = effect.verdict or "provisional"
    higher = list(effect.to_confirm or []) or [RAISED[level]] if level in RAISED else list(effect.to_confirm or [])
    remarks = list(_remarks(effect, unit))
    return Claim(format_claim(effect), level, LEVELS.get(level, ""), list(_tests(effect)), higher, remarks)


def _tests(effect: NamedEffect) -> Iterator[Test]:
    gates = effect.gates.model_dump() if effect.gates is not None else {}
    evidence = effect.evidence or Evidence()
    for name, (words, say) in GATES.items():
        if gates.get(name) is not None:
            yield Test(words, bool(gates[name]), say(evidence))


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
