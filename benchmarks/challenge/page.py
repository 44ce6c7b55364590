"""One page of the score: the figures, the families, and every wrong claim by its case."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.challenge.score import Effect, Scored, at_place, figures
from tests.blind.bounds import clopper_pearson


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
