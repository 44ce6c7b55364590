"""A fixed sample of the blind benchmark on campaigns as a careful user makes them: what may never happen, and what
must mostly work. The hard campaigns are for ``python -m tools.lab blind``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

pytest.importorskip("kilter_core.gap")

from tests.blind.bounds import Figure
from tests.blind.claims import STRONG, right, sure
from tests.blind.generator import Case, Options, cases
from tests.blind.generator.outside import SMOOTH
from tests.blind.generator.physics import PER_JOINT, WHOLE_ARM
from tests.blind.run import run
from tests.blind.score import figures

SEED = 20240229
pytestmark = pytest.mark.timeout(1200)  # the sample takes a minute on a quiet machine

# A fault that makes one claim in ten wrong is seen in three of four such samples, one in five in 24 of 25: of the 14 cases
# whose truth can be told none may be wrong. A rate of wrong names of 1 % is for the 1000 cases of ``tools.lab blind``.
QUOTA = {"no_gap": 6, "named": 6, "outside": 2, "undecidable": 2}
OLD = {*PER_JOINT, *WHOLE_ARM, "joint_coupling", "gravity_spring"}  # what has always been in the library


def eased() -> Iterator[Case]:
    """Cases with stable repeats and masses within 5 %, that hide long known effects and no smooth curves."""
    left = dict(QUOTA)
    for case in cases(SEED, 400, poses=(30, 60)):
        known = [s for s in (case.hidden, *case.alternatives) if all(h.id in OLD for h in s)]
        if case.expectation == "outside" and case.hidden[0].id not in SMOOTH:
            known = [case.hidden]
        if not known or not left[case.expectation]:
            continue
        left[case.expectation] -= 1
        easy = Options(
            approach=case.options.approach, payload=case.options.payload, temperature=case.options.temperature,
            sessions=case.options.sessions, mass_error=0.05, com_error_mm=2.0,
        )  # fmt: skip
        yield replace(case, options=easy, hidden=known[0], alternatives=tuple(known[1:]))


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    return run(list(eased()), tmp_path_factory.mktemp("blind") / "records.jsonl")


@pytest.fixture(scope="module")
def by_title(records: list[dict[str, Any]]) -> dict[str, Figure]:
    return {figure.title: figure for figure in figures(records)}


def test_every_run_ends(records: list[dict[str, Any]]) -> None:
    assert not [(r["name"], r["error"]) for r in records if r["report"] is None]


def test_nothing_is_confirmed_when_nothing_is_hidden(by_title: dict[str, Figure]) -> None:
    assert by_title["confirmed when nothing is hidden"].k == 0
    assert by_title["confirmed when nothing is hidden"].n >= 5
    assert by_title["any name when nothing is hidden"].k <= 1


def test_no_confirmed_name_is_wrong(records: list[dict[str, Any]]) -> None:
    wrong = [
        (r["name"], e["id"], e["joints"])
        for r in records
        if r["truth"]["expectation"] != "undecidable"
        for e in sure(r["report"]["effects"])
        if not right(e, r["truth"])
    ]
    assert not wrong


def test_what_the_library_does_not_hold_is_not_confirmed(by_title: dict[str, Figure]) -> None:
    assert by_title["– the same, smooth and outside cases alone"].k == 0
    assert by_title["– the same, smooth and outside cases alone"].n >= 2


def test_strong_effects_are_seen_and_named(by_title: dict[str, Figure]) -> None:
    assert by_title[f"power: a gap is named at λ ≥ {STRONG:.0f}"].share >= 0.8
    assert by_title["exact name at λ ≥ 30 and λ(1−ρ) ≥ 11"].share >= 0.75
    assert by_title["truth in the alias set, λ ≥ 30"].share >= 0.8


def test_what_cannot_be_told_is_not_told(by_title: dict[str, Figure]) -> None:
    figure = by_title["undecidable said undecidable"]
    assert figure.n >= 2
    assert figure.share >= 0.5
