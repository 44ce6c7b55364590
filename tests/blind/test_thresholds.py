"""Thresholds decided again from what a run keeps, and changed in a running finder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import kilter_core.gap.search.select
import tests.blind.thresholds as thresholds
from tests.blind.generator import Case
from tests.blind.generator.cases import cases
from tests.blind.thresholds import BEGIN, END, GATES, SEARCH, Gate, Score, decided, fill, gate_table, known, patched


def effect(name: str, verdict: str, gates: dict[str, bool], **evidence: float) -> dict[str, Any]:
    return {"id": name, "joints": [2], "verdict": verdict, "alias_set": [], "gates": gates, "evidence": evidence}


def record(*effects: dict[str, Any]) -> dict[str, Any]:
    hidden = {"id": "backlash", "joints": [2], "joint_lam": {}, "rho": 0.1, "lam_partial": 90.0, "lam": 90.0}
    truth = {"effects": [hidden], "background": None, "payload_wrong": False, "expectation": "named"}
    return {"name": "x", "truth": truth, "report": {"effects": list(effects), "gap": {}}}


def gate(constant: str) -> Gate:
    return next(g for g in GATES if g.constant == constant)


def test_a_gate_is_decided_again_by_the_number_behind_it() -> None:
    gain, inclusion = gate("evidence.verdict.SURE_GAIN"), gate("evidence.verdict.INCLUDED")
    good = effect("backlash", "confirmed", {"held_out": True, "inclusion": True}, held_out=3.0, inclusion=0.85)
    bad = effect("eccentricity", "provisional", {"held_out": False, "inclusion": True}, held_out=1.5, inclusion=1.0)

    def verdicts(g: Gate, factor: float) -> list[str]:
        report = decided(record(good, bad), g, factor)["report"]
        assert report is not None
        return [e["verdict"] for e in report["effects"]]

    assert verdicts(gain, 1.0) == ["confirmed", "provisional"]
    assert verdicts(gain, 0.5) == ["confirmed", "confirmed"]
    assert verdicts(gain, 2.0) == ["provisional", "provisional"]
    assert inclusion.value(0.5) == pytest.approx(0.9)
    assert inclusion.value(2.0) == pytest.approx(0.6)
    assert verdicts(inclusion, 0.5) == ["provisional", "provisional"]


def test_a_gate_that_something_else_decided_stays() -> None:
    local = effect("backlash", "confirmed", {"no_empirical_alias": True}, no_empirical_alias=-2.0)
    (left,) = decided(record(local), gate("search.select.MARGIN"), 2.0)["report"]["effects"]
    assert left["verdict"] == "confirmed"
    silent = effect("backlash", "provisional", {"held_out": False})
    assert decided(record(silent), gate("evidence.verdict.SURE_GAIN"), 0.5) == record(silent)


def test_the_score_counts_wrong_runs_and_claims() -> None:
    good = record(effect("backlash", "confirmed", {}))
    lie = record(effect("backlash", "provisional", {}), effect("drift", "confirmed", {}))
    score = Score.of([good, lie])
    assert (score.wrong, score.claimed, score.named, score.exact) == ((1, 2), (1, 2), (2, 2), (1, 2))
    assert score.of_gate() == "50.0% / 50.0%"
    assert "`evidence.verdict.SURE_GAIN` | 3 |" in gate_table([good])


def test_a_changed_constant_reaches_all_who_took_it_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    before, seen = kilter_core.gap.search.select.MARGIN, []

    def look(case: Case) -> dict[str, Any]:
        seen.append(kilter_core.gap.search.select.MARGIN)
        return {}

    monkeypatch.setattr(thresholds, "run_case", look)
    patched("search.select.MARGIN", 2.0, next(cases(0, 1)))
    assert seen == [2.0 * before]
    assert before == kilter_core.gap.search.select.MARGIN


def test_every_constant_of_the_tables_is_one_of_the_finder() -> None:
    assert known(["search.select.MARGIN", "search.select.NOT_THERE", "nowhere.MARGIN"]) == ["search.select.MARGIN"]
    assert len(known(SEARCH)) >= 14
    assert len(known(g.constant for g in GATES)) >= 6


def test_the_tables_go_between_their_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    fill("new", page)
    fill("newer", page)
    assert page.read_text() == f"before\n{BEGIN}\n\nnewer\n\n{END}\nafter\n"
    page.write_text("nothing")
    with pytest.raises(ValueError, match="to write between"):
        fill("new", page)
