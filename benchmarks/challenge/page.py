"""One page of the score: the figures, the families, and every wrong claim by its case.

Who was right: by physical class, by exact name, by size, and on rows the search never saw.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.challenge.case import Hidden, Truth
from tests.blind.bounds import Figure, by_pose, clopper_pearson, share


def page(scored: Sequence[Scored], sealed: Sequence[str]) -> str:
    """Markdown; ``sealed`` are cases that were answered and whose truth is not opened yet."""
    parts = ["# Score of the hidden cases", "", f"{len(scored)} cases scored, {len(sealed)} still sealed.", ""]
    if scored:
        parts += ["| figure | aim | found | of | 95 % bounds |", "|---|---|---|---|---|"]
        parts += [figure.row() for figure in figures(scored)]
        parts += ["", "## By family", "", *_families(scored), "", "## Wrong claims and failures", "", *_wrong(scored)]
    if sealed:
        parts += ["", f"Answered and still sealed: {', '.join(sealed)}."]
    return "\n".join(parts) + "\n"


def _families(scored: Sequence[Scored]) -> list[str]:
    lines = [
        "| family | cases | found in class | exact | wrong claims | bounds of wrong |",
        "|---|---|---|---|---|---|",
    ]
    for family in dict.fromkeys(s.truth.family for s in scored):
        some = [s for s in scored if s.truth.family == family and s.answered]
        found = sum(all(any(at_place(e, h) for e in s.effects) for h in s.demanded) for s in some if s.demanded)
        wrong = sum(bool(s.wrong()) for s in some)
        low, high = clopper_pearson(wrong, len(some))
        exact = sum(s.exact() for s in some)
        lines.append(f"| {family} | {len(some)} | {found} | {exact} | {wrong} | {low:.1%} – {high:.1%} |")
    return lines


def _wrong(scored: Sequence[Scored]) -> list[str]:
    lines = []
    for s in scored:
        if not s.answered:
            lines.append(f"- `{s.name}` failed: {s.answer['error']}")
            continue
        hidden = "; ".join(h.says or f"{h.physical_class} {h.joints}" for h in s.truth.hidden) or "nothing"
        lines += [f"- `{s.name}`: said *{said(e)}* ({e['verdict']}); hidden was {hidden}" for e in s.wrong()]
    return lines or ["None."]


def said(effect: Effect) -> str:
    """What the search says of an effect, in its own words."""
    return str((effect.get("claim") or {}).get("words") or effect["id"])


CLAIMED = ("class_confirmed", "confirmed", "replicated")
MEMBER, ONE_OF = "member", "one_of"  # what a claim says of itself when it names causes

Effect = Mapping[str, Any]  # one of the effects of a result of a gap search


@dataclass(frozen=True)
class Scored:
    """A case, what was answered, and what was hidden."""

    name: str
    truth: Truth
    answer: Mapping[str, Any]

    @property
    def answered(self) -> bool:
        """Whether the search ended with a result."""
        return self.answer["report"] is not None

    @property
    def effects(self) -> list[Effect]:
        """What was named, shapes without a cause left out."""
        return [e for e in self.answer["report"]["effects"] if not e["empirical"]] if self.answered else []

    @property
    def demanded(self) -> list[Hidden]:
        """Hidden effects that must be found."""
        return [h for h in self.truth.hidden if h.demanded]

    def wrong(self) -> list[Effect]:
        """Claims outside the class of everything hidden, or of a member that is not hidden."""
        return [e for e in self.effects if e["verdict"] in CLAIMED and not any(holds(e, h) for h in self.truth.hidden)]

    def exact(self) -> bool:
        """Whether all that is demanded is named by its name, and nothing else is."""
        extra = [e for e in self.effects if not any(named(e, h) for h in self.truth.hidden)]
        return not extra and all(any(named(e, h) for e in self.effects) for h in self.demanded)


def at_place(effect: Effect, hidden: Hidden) -> bool:
    """Whether an effect is of the hidden one's physical class, at one of its joints."""
    joints = set(effect.get("joints") or ())
    near = not joints or not hidden.joints or bool(joints & set(hidden.joints))
    return bool(near and effect["physical_class"]["id"] == hidden.physical_class)


def holds(effect: Effect, hidden: Hidden) -> bool:
    """Whether what is claimed is true of a hidden effect: its name, one of several names, or its class."""
    said = (effect.get("claim") or {}).get("said")
    if said == MEMBER:
        return named(effect, hidden)
    ids = {effect["id"], *(rival["id"] for rival in effect["alias_set"])}
    listed = said == ONE_OF and bool(ids & set(hidden.effects)) and _beside(effect, hidden)
    return listed or at_place(effect, hidden)


def named(effect: Effect, hidden: Hidden) -> bool:
    """Whether an effect has a right name of the hidden one, at its joints."""
    if effect["id"] not in hidden.effects:
        return False
    joints = effect.get("joints")
    return not hidden.joints or joints is None or set(joints) <= set(hidden.joints)


def _beside(effect: Effect, hidden: Hidden) -> bool:
    """Whether the effect or one of its rivals acts at a joint of the hidden one, or one of them at none."""
    places = [set(one.get("joints") or ()) for one in (effect, *effect["alias_set"])]
    return not hidden.joints or any(not place or place & set(hidden.joints) for place in places)


def figures(scored: Sequence[Scored]) -> list[Figure]:
    """The figures of the score, each with its bounds."""
    done = [s for s in scored if s.answered]
    empty = [s for s in done if not s.truth.hidden]
    hiding = [s for s in done if s.demanded]
    effects = [(s, h) for s in hiding for h in s.demanded]
    nameable = [s for s in hiding if all(h.effects for h in s.demanded)]
    poses = [(int(k), int(n)) for s in done for k, n in (s.answer["report"]["predictive"] or {}).get("poses") or ()]
    return [
        share("confirmed outside the true class, or under a wrong name", "≤ 0.5 %", [bool(s.wrong()) for s in done]),
        share("any name when nothing is hidden", "≤ 1 %", [bool(s.effects) for s in empty]),
        share("found in its class", "≥ 99 %", [any(at_place(e, h) for e in s.effects) for s, h in effects]),
        share("exact names, and no others", "≥ 97 %", [s.exact() for s in nameable]),
        Figure(
            "gap closed on held-out rows, pooled", "≥ 95 %", value=100.0 * closure(hiding), unit=" %", n=len(hiding)
        ),
        share("95 % intervals that hold the true size", "94 – 96 %", list(_intervals(done))),
        by_pose("held-out coordinates inside their 95 % intervals", "93 – 97 %", poses),
        Figure("seconds of a search, longest", "≤ 20", value=max(s.answer["seconds"] for s in scored), unit=" s"),
        share("searches that failed", "0", [not s.answered for s in scored]),
    ]


def closure(scored: Sequence[Scored]) -> float:
    """Compute (R0² - R1²) / (R0² - noise²) on held-out rows, sums over the cases; nan where none has all three."""
    gaps = [s.answer["report"]["gap"] or {} for s in scored]
    names = ("validation_before_mm", "validation_after_mm", "validation_noise_rms_mm")
    known = [[g[name] ** 2 for name in names] for g in gaps if all(g.get(name) is not None for name in names)]
    before, after, noise = (sum(column) for column in zip(*known, strict=True)) if known else (0.0, 0.0, 0.0)
    return (before - after) / (before - noise) if before > noise else math.nan


def _intervals(scored: Sequence[Scored]) -> Iterator[bool]:
    for s in scored:
        found = {p["name"]: p for e in s.effects for p in e["parameters"]}
        for size in (size for hidden in s.truth.hidden for size in hidden.sizes):
            if (p := found.get(size.name)) is not None:
                yield p["interval_low"] <= size.value <= p["interval_high"]
