"""The page of the benchmark: docs/reference/gap-finder-benchmark.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.blind.claims import STRONG, empirical, named, right, sure
from tests.blind.score import Record, decidable, figures

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "gap-finder-benchmark.md"
INTRODUCTION = """# How often the gap finder is right

The benchmark simulates arms with hidden physics, measured by a laser tracker, and gives the gap finder a robot document
and rows. Its generator (`tests/blind/generator`) shares no code with Kilter: Pinocchio's kinematics and loads, finite
motions, errors of every joint placement, tracker noise that grows with range, scatter of each approach. There are three
arms (Katana 450, a six-axis elbow arm, a seven-axis arm) and 30, 60 or 118 poses.

Link masses are wrong in every case (up to 10 or 20 %, centres by up to 10 mm, the payload by up to 5 % and 8 mm). In
some cases half of the joints stay within ±75°, repeats are few, none or taken without leaving the pose, or up to 15 %
of the visits are wrong. In every third case that hides nothing, and in every tenth set, base or instrument moves
slowly. This motion may be named, but nothing in the arm. Effects outside the library are smooth curves of one joint,
bumps, fields and errors of the tracker's circles, and twins of members that follow a clock as these do. In every
second case a campaign of another day can replicate what was found.

λ is the non-centrality of an effect, in units of the noise, after removing what geometry can imitate. ρ is the share
of it that the nearest other effect can imitate. The effects of a set are decidable when each has λ ≥ 30 and λ(1−ρ) ≥
11 in the presence of the others. An ideal test knows everything else about a case: the geometry, the other effects and
the only rival. It has the search's poses and repeats, and may name something in 1 % of the cases that hide nothing.

`python -m tools.lab blind --n {n}` measured this ({runs} runs, seed {seed}). Bounds are exact 95 % bounds (Clopper and
Pearson). Times are processor times; `python -m tools.lab bench-gap` measures how long a user waits. Of 1000 cases 400
hide nothing in the arm (140 of those drift), 480 hide one, two or three decidable effects, 80 are outside the library,
40 are twins of members.

| figure | aim | found | of | bounds |
|---|---|---|---|---|
"""


def write_page(records: Sequence[Record], seed: int, path: Path = PAGE) -> None:
    """Write the table of figures, and where the finder was wrong."""
    head = INTRODUCTION.format(n=len(records), runs=len(records), seed=seed)
    rows = "\n".join(f.row() for f in figures(records))
    path.write_text(f"{head}{rows}\n\n{_by_effect(records)}\n{_lies(records)}")


def _by_effect(records: Sequence[Record]) -> str:
    """Exact names per effect, decidable or not."""
    tally: dict[str, list[tuple[bool, bool, bool]]] = {}
    for r in records:
        if r["report"] is None or r["truth"]["expectation"] != "named":
            continue
        for h in r["truth"]["effects"]:
            exact = any(named(e, h) for e in r["report"]["effects"])
            strong = h["lam_partial"] >= STRONG
            tally.setdefault(h["id"], []).append((strong, strong and decidable(h), exact))
    lines = ["## By effect", "", "| effect | hidden | λ ≥ 30 | decidable | named exactly |", "|---|---|---|---|---|"]
    for effect, rows in sorted(tally.items()):
        able = [exact for _, clear, exact in rows if clear]
        lines.append(f"| `{effect}` | {len(rows)} | {sum(s for s, _, _ in rows)} | {len(able)} | {sum(able)} |")
    return "\n".join(lines) + "\n"


def _lies(records: Sequence[Record]) -> str:
    """Every confirmed name that was wrong, so that each can be looked into."""
    lines = []
    for r in records:
        if r["report"] is None:
            lines.append(f"- `{r['name']}` failed: {r['error']}")
            continue
        if r["truth"]["expectation"] == "undecidable":
            continue
        wrong = [e for e in sure(r["report"]["effects"]) if not right(e, r["truth"])]
        hidden = _hidden(r["truth"])
        lines += [f"- `{r['name']}`: said {_label(e)} ({e['verdict']}), hidden was {hidden}" for e in wrong]
    title = "## Confirmed but wrong, and failed"
    return "\n".join([title, "", *(lines or ["None."])]) + "\n"


def _hidden(truth: Mapping[str, Any]) -> str:
    said = [_label(e) for e in truth["effects"] if not empirical(e)]
    if truth["background"]:
        said.append(f"a base that moves ({truth['background']['kind']})")
    return ", ".join(said) or "nothing"


def _label(effect: Mapping[str, Any]) -> str:
    joints = effect.get("joints")
    return str(effect["id"]) + (f" {','.join(map(str, joints))}" if joints else "")
