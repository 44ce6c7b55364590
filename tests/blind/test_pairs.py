"""The pairs of the benchmark: what differs between the two sides, and how they are counted."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.blind.generator import generate
from tests.blind.pairs import RIGHT, WRONG, pairs, table


def test_a_pair_differs_in_the_masses_alone() -> None:
    drawn = list(pairs(rounds=1))
    assert len(drawn) == 18
    first, second = (generate(case) for case in drawn[:2])
    assert first.columns.keys() == second.columns.keys()
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, second.columns[name])
    assert first.truth.effects == second.truth.effects
    known, told = first.document.pop("links"), second.document.pop("links")
    assert first.document == second.document
    ratio = [b["mass_kg"] / a["mass_kg"] for a, b in zip(known, told, strict=True) if a["mass_kg"]]
    assert 0.05 < np.max(np.abs(np.subtract(ratio, 1.0))) <= 0.1


def test_every_effect_of_a_pair_can_be_decided() -> None:
    drawn = [case for case in pairs() if case.name.startswith(RIGHT)]
    assert len(drawn) == 18
    assert {case.hidden[0].id for case in drawn} == {"clearance_tilt", "backlash_load"}
    for case in drawn[::4]:
        assert all(e.decidable for e in generate(case).truth.effects)


def test_the_table_counts_each_side() -> None:
    hidden = {"id": "backlash_load", "joints": [2], "joint_lam": {}, "rho": 0.1, "lam_partial": 90.0}
    truth = {"effects": [hidden], "background": None, "payload_wrong": False}

    def record(side: str, verdict: str, *effects: dict[str, Any]) -> dict[str, Any]:
        return {"name": f"{side}-0", "truth": truth, "report": {"verdict": verdict, "effects": list(effects)}}

    good = {"id": "backlash_load", "joints": [2], "verdict": "confirmed", "alias_set": []}
    bad = {"id": "drift", "joints": None, "verdict": "confirmed", "alias_set": []}
    shape = {"id": "unknown_joint_curve", "joints": [2], "verdict": "provisional", "alias_set": []}
    text = table([record(RIGHT, "closed", good), record(WRONG, "unexplained", bad, shape)])
    assert "| right | 1 | 1 | 1 | 0 | 0 | 0 |" in text
    assert "| wrong | 1 | 0 | 0 | 1 | 1 | 1 |" in text
