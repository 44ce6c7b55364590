"""What each threshold of the gap finder is worth: the score at half, at its value and at double.

``python -m tests.blind.thresholds --records build/blind-0.jsonl``. Thresholds of the gates are applied anew to the
numbers that a run keeps; those that steer the search need runs of their own, on the same cases: ``--search``.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tests.blind.claims import STRONG, found, named, right, sure
from tests.blind.generator import Case, cases
from tests.blind.run import RECORDS, run, run_case
from tests.blind.score import Record, decidable, exact, wrong

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "gap-statistics.md"
BEGIN, END = "<!-- blind scores: begin -->", "<!-- blind scores: end -->"
FACTORS = (0.5, 1.0, 2.0)
PAIRED = 100
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Gate:
    """A threshold that a number kept in a report is held against: where it stands, and which side passes.

    ``number`` is the name of the number in ``evidence``, ``gate`` the one it decides. ``least``: the number must
    reach the threshold. ``complement``: the threshold is a share near one, and its distance from one is halved.
    """

    constant: str
    number: str
    gate: str
    least: bool
    complement: bool = False

    def value(self, factor: float = 1.0) -> float:
        """The threshold, changed by a factor."""
        module, _, name = self.constant.rpartition(".")
        own = float(getattr(importlib.import_module(f"kilter_core.gap.{module}"), name))
        return 1.0 - (1.0 - own) * factor if self.complement else own * factor

    def passes(self, number: float, factor: float) -> bool:
        """Whether a number would pass."""
        return number >= self.value(factor) if self.least else number <= self.value(factor)


GATES = (
    Gate("evidence.verdict.SURE_GAIN", "held_out", "held_out", least=True),
    Gate("search.select.MARGIN", "no_empirical_alias", "no_empirical_alias", least=True),
    Gate("evidence.verdict.SHADOWED", "shadowed", "no_empirical_alias", least=False),
    Gate("evidence.verdict.CONTRADICTS", "plausible", "plausible", least=False),
    Gate("evidence.verdict.INCLUDED", "inclusion", "inclusion", least=True, complement=True),
    Gate("evidence.control.SURVIVING", "negative_control", "negative_control", least=False),
    Gate("evidence.replication.AGREES", "confirmation", "confirmation", least=False),
)
SEARCH = (
    "search.select.MARGIN",
    "search.select.FAMILY_MARGIN",
    "search.select.MOST_JOINTS",
    "search.select.SMALLEST_GAIN",
    "search.candidate_sets.CLEARLY_WRONG",
    "search.select.HIDING",
    "search.scan.CAUTION",
    "search.scan.STRICTER",
    "search.outliers.CHANCE",
    "search.outliers.MOST",
    "search.outliers.SUPPLE",
    "noise.from_repeats.SPIKE",
    "noise.covariance_models.SPHERICAL",
    "search.linear.gram.FIRM",
    "evidence.similarity.smooth.FAIR",
    "evidence.similarity.testability.BARELY",
    "study.SHARE",
)


def known(constants: Iterable[str]) -> list[str]:
    """Those of the constants ``module.NAME`` that this finder has."""
    return [c for c in constants if _has(c)]


def _has(constant: str) -> bool:
    module, _, name = constant.rpartition(".")
    try:
        return hasattr(importlib.import_module(f"kilter_core.gap.{module}"), name)
    except ModuleNotFoundError:
        return False


def decided(record: Record, gate: Gate, factor: float) -> Record:
    """A record with every effect's verdict as it were with one threshold changed."""
    report = record["report"]
    if report is None:
        return record
    effects = [_decided(e, gate, factor) for e in report["effects"]]
    return {**record, "report": {**report, "effects": effects}}


def _decided(effect: Row, gate: Gate, factor: float) -> Row:
    number = (effect.get("evidence") or {}).get(gate.number)
    if number is None or gate.passes(number, factor) == gate.passes(number, 1.0):
        return effect
    gates = {**effect["gates"], gate.gate: gate.passes(number, factor)}
    return {**effect, "gates": gates, "verdict": _level(effect, gates)}


def _level(effect: Row, gates: Mapping[str, bool]) -> str:
    if not all(gates.values()):
        return "provisional"
    replication = effect.get("replication") or {}
    if "replicated" in (effect["verdict"], replication.get("outcome")):
        return "replicated"
    said = (effect.get("claim") or {}).get("said", "one_of" if effect["alias_set"] else "member")
    return "confirmed" if said == "member" else "class_confirmed"


@dataclass(frozen=True)
class Score:
    """Runs with a wrong claim; of the effects that could be decided those claimed, and those named at all; exact sets."""

    wrong: tuple[int, int]
    claimed: tuple[int, int]
    named: tuple[int, int]
    exact: tuple[int, int]

    @staticmethod
    def of(records: Sequence[Record]) -> Score:
        """Count."""
        done = [r for r in records if r["report"] is not None and r["truth"]["expectation"] != "undecidable"]
        hidden = [(r, h) for r in done if r["truth"]["expectation"] == "named" for h in r["truth"]["effects"]]
        clear = [(r, h) for r, h in hidden if h["lam_partial"] >= STRONG and decidable(h)]
        sets = [r for r in done if r["truth"]["effects"] and all(_clear(h) for h in r["truth"]["effects"])]
        sets = [r for r in sets if r["truth"]["expectation"] == "named"]
        return Score(
            (sum(wrong(r) for r in done), len(done)),
            (sum(_claimed(r, h) for r, h in clear), len(clear)),
            (sum(found(r["report"], h) for r, h in clear), len(clear)),
            (sum(exact(r) for r in sets), len(sets)),
        )

    def of_gate(self) -> str:
        """Wrong runs and claims, which is all that a gate changes."""
        return f"{_share(self.wrong)} / {_share(self.claimed)}"

    def of_search(self) -> str:
        """Wrong runs, names and exact sets."""
        return f"{_share(self.wrong)} / {_share(self.named)} / {_share(self.exact)}"


def _clear(h: Row) -> bool:
    return bool(h["lam_partial"] >= STRONG and decidable(h))


def _claimed(r: Record, hidden: Row) -> bool:
    return any(named(e, hidden) and right(e, r["truth"]) for e in sure(r["report"]["effects"]))


def _share(count: tuple[int, int]) -> str:
    return f"{count[0] / count[1]:.1%}" if count[1] else "–"


def gate_table(records: Sequence[Record]) -> str:
    """Thresholds of the gates, each halved and doubled, on stored records."""
    head = "| gate | its value | at half | as it is | at double |\n|---|---|---|---|---|"
    rows = [
        f"| `{g.constant}` | {g.value():g} | "
        + " | ".join(Score.of([decided(r, g, f) for r in records]).of_gate() for f in FACTORS)
        + " |"
        for g in GATES
        if _has(g.constant)
    ]
    return "\n".join([head, *rows])


def patched(constant: str, factor: float, case: Case) -> dict[str, Any]:
    """Run a case with one constant of the finder changed, in every module that took it by name."""
    module, _, name = constant.rpartition(".")
    before = getattr(importlib.import_module(f"kilter_core.gap.{module}"), name)
    holders = [
        m for key, m in sys.modules.items() if key.startswith("kilter_core.gap") and getattr(m, name, None) is before
    ]
    for holder in holders:
        setattr(holder, name, type(before)(before * factor))
    try:
        return run_case(case)
    finally:
        for holder in holders:
            setattr(holder, name, before)


def search_table(constants: Sequence[str], n: int, seed: int, processes: int, folder: Path) -> str:
    """Thresholds that steer the search, each halved and doubled, run anew on the same cases."""
    wanted = list(cases(seed, n))
    plain = Score.of(run(wanted, folder / "as-it-is.jsonl", processes)).of_search()
    rows = ["| steers the search | its value | at half | as it is | at double |", "|---|---|---|---|---|"]
    for constant in constants:
        module, _, name = constant.rpartition(".")
        value = getattr(importlib.import_module(f"kilter_core.gap.{module}"), name)
        half, double = (_scored(partial(patched, constant, f), wanted, folder / f"{constant}-{f:g}.jsonl", processes)
                        for f in (0.5, 2.0))  # fmt: skip
        rows.append(f"| `{constant}` | {value:g} | {half} | {plain} | {double} |")
    return "\n".join(rows)


def _scored(one: Callable[[Case], dict[str, Any]], wanted: Sequence[Case], path: Path, processes: int) -> str:
    return Score.of(run(wanted, path, processes, one)).of_search()


def fill(text: str, path: Path = PAGE) -> None:
    """Put the tables between their two marks on the page."""
    page = path.read_text()
    head, _, rest = page.partition(BEGIN)
    _, found_end, tail = rest.partition(END)
    if not found_end:
        raise ValueError(f"{path} has no {BEGIN} and {END} to write between.")
    path.write_text(f"{head}{BEGIN}\n\n{text}\n\n{END}{tail}")


def main() -> None:
    """Print the tables, and write them into the page when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=Path, default=RECORDS / "blind-0.jsonl")
    parser.add_argument("--search", action="store_true", help="run the thresholds of the search too; this takes hours")
    parser.add_argument("--only", nargs="*", default=list(SEARCH), help="of these constants, as search.select.MARGIN")
    parser.add_argument("--n", type=int, default=PAIRED)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", action="store_true", help=f"write into {PAGE.name}")
    asked = parser.parse_args()
    records = [json.loads(line) for line in asked.records.read_text().splitlines()]
    text = f"Runs with a wrong claim / decidable effects claimed, of {len(records)} runs:\n\n{gate_table(records)}"
    if asked.search:
        table = search_table(known(asked.only), asked.n, asked.seed, asked.processes, RECORDS / "thresholds")
        text += (
            f"\n\nRuns with a wrong claim / decidable effects named / exact sets, of {asked.n} runs of the same cases:"
            f"\n\n{table}"
        )
    print(text)
    if asked.write:
        fill(text)


if __name__ == "__main__":
    main()
