"""The page of the benchmark: docs/reference/gap-finder-benchmark.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.blind.score import EMPIRICAL, Record, figures, named, rho_of, right, sure

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "gap-finder-benchmark.md"
INTRODUCTION = """# How often the gap finder is right

Simulated arms with hidden physics, measured by a simulated laser tracker, given to the gap finder as a robot document
and a table of observations. The generator (`tests/blind/generator`) shares no code with Kilter: kinematics and loads by
Pinocchio, finite motions joint by joint, hidden errors of every joint placement, link masses up to 20 % off in two
cases of five, tracker noise that grows with range and lies across the beam, scatter of each approach, up to 1.5 % wrong
readings, repeats. Three arms: the Katana 450, a six-axis elbow arm, a seven-axis arm; 30, 60 or 118 poses.

λ is the non-centrality of an effect: the square of its signature in units of the noise, after everything that geometry
can imitate has been taken away. ρ is the part of it that the nearest other name can imitate.

`make blind N={n}` measured this ({runs} runs, seed {seed}). Bounds are exact 95 % bounds (Clopper and Pearson). Times are
those of a machine that did other work as well: `make bench-gap` measures them alone.

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
            decidable = h["lam_partial"] * (1.0 - rho_of(h)) >= 11.0
            tally.setdefault(h["id"], []).append((h["lam_partial"] >= 30.0, decidable, exact))
    lines = ["## By effect", "", "| effect | hidden | λ ≥ 30 | decidable | named exactly |", "|---|---|---|---|---|"]
    for effect, rows in sorted(tally.items()):
        able = [exact for _, decidable, exact in rows if decidable]
        lines.append(f"| `{effect}` | {len(rows)} | {sum(s for s, _, _ in rows)} | {len(able)} | {sum(able)} |")
    return "\n".join(lines) + "\n"


def _lies(records: Sequence[Record]) -> str:
    """Every confirmed name that was wrong, so that each can be looked into."""
    lines = []
    for r in records:
        if r["report"] is None:
            lines.append(f"- `{r['name']}` failed: {r['error']}")
            continue
        expectation, truth = r["truth"]["expectation"], r["truth"]["effects"]
        if expectation == "undecidable":
            continue
        wrong = [e for e in sure(r["report"]["effects"]) if expectation != "named" or not right(e, truth)]
        hidden = _labels(truth)
        lines += [f"- `{r['name']}`: said {_label(e)} ({e['verdict']}), hidden was {hidden}" for e in wrong]
    title = "## Confirmed but wrong, and failed"
    return "\n".join([title, "", *(lines or ["None."])]) + "\n"


def _labels(effects: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(_label(e) for e in effects if e["id"] not in EMPIRICAL) or "nothing"


def _label(effect: Mapping[str, Any]) -> str:
    joints = effect.get("joints")
    return str(effect["id"]) + (f" {','.join(map(str, joints))}" if joints else "")
