"""The scoring: bounds, and who is right."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.blind.bounds import Figure, by_pose, clopper_pearson
from tests.blind.claims import names, said_undecidable
from tests.blind.claims import right as right_of
from tests.blind.score import closure, exact, figures, ideal


def hidden(effect: str, joints: list[int], **joint_lam: float) -> dict[str, Any]:
    return {
        "id": effect,
        "joints": joints,
        "joint_lam": {k[1:]: v for k, v in joint_lam.items()},
        "lam": 100.0,
        "lam_partial": 100.0,
        "rho": 0.5,
        "freedom": len(joints) or 1,
        "parameters": {f"b_{j}": 1.0e-4 for j in joints},
    }


def said(
    effect: str, joints: list[int] | None, verdict: str = "confirmed", *aliases: tuple[str, list[int]]
) -> dict[str, Any]:
    rows = [{"id": i, "joints": j} for i, j in aliases]
    return {"id": effect, "joints": joints, "verdict": verdict, "alias_set": rows, "parameters": []}


def record(effects: list[dict[str, Any]], truth: list[dict[str, Any]], expectation: str) -> dict[str, Any]:
    gap = {"validation_before_mm": 0.05, "validation_after_mm": 0.03, "validation_noise_rms_mm": 0.03}
    noise = {"absolute": True, "freedom": 60.0}
    report = {"verdict": "closed", "effects": effects, "gap": gap, "noise": noise, "not_testable": []}
    kept = {"effects": truth, "expectation": expectation, "undecidable": [], "background": None, "payload_wrong": False}
    return {"name": "x", "case": {"poses": 60}, "truth": kept, "report": report, "error": None, "seconds": 1.0}


def right(effect: dict[str, Any], effects: list[dict[str, Any]], **more: Any) -> bool:
    return right_of(effect, {"effects": effects, "background": None, "payload_wrong": False, **more})


def test_bounds_are_the_exact_ones() -> None:
    assert clopper_pearson(0, 400) == pytest.approx((0.0, 0.00918), abs=1e-5)
    assert clopper_pearson(5, 10) == pytest.approx((0.18709, 0.81291), abs=1e-5)
    assert clopper_pearson(10, 10)[1] == 1.0
    assert clopper_pearson(0, 0) == (0.0, 1.0)


def test_a_name_is_id_and_joints() -> None:
    one = hidden("backlash", [3])
    assert names(said("backlash", [3]), one)
    assert not names(said("backlash", [2]), one)
    assert not names(said("backlash", [1, 2, 3]), one)
    assert not names(said("eccentricity", [3]), one)
    family = hidden("backlash", [1, 2, 3], j1=2.0, j2=40.0, j3=50.0)
    assert names(said("backlash", [2, 3, 4]), family)
    assert not names(said("backlash", [1, 3]), family)
    assert names(said("drift", None), hidden("drift", []))


def test_a_confirmed_name_must_be_hidden_and_a_class_must_hold_it() -> None:
    truth = [hidden("friction_windup", [2])]
    assert right(said("friction_windup", [2]), truth)
    assert right(said("backlash", [2], "class_confirmed", ("friction_windup", [2])), truth)
    assert not right(said("backlash", [2]), truth)
    assert not right(said("eccentricity", [2], "class_confirmed", ("encoder_scale", [2])), truth)
    other = [hidden("eccentricity", [2])]
    assert right(said("encoder_scale", [2], "class_confirmed", ("eccentricity", [2])), other)
    assert not right(said("encoder_scale", [2], "confirmed", ("eccentricity", [2])), other)
    family = [hidden("backlash", [1, 2, 3], j1=2.0, j2=40.0, j3=50.0)]
    assert right(said("backlash", [2]), family)
    again = said("encoder_scale", [2], "replicated", ("eccentricity", [2]))
    assert right(again, other)
    assert not right({**again, "alias_set": []}, other)


def test_a_slow_motion_of_the_base_may_be_named_where_there_is_one_and_nothing_in_the_arm() -> None:
    slow = {"kind": "thermal", "id": None}
    for name in ("drift", "settling", "random_walk", "base_step", "column_bending"):
        assert right(said(name, None), [], background=slow)
        assert not right(said(name, None), [])
    assert not right(said("eccentricity", [2]), [], background=slow)
    assert not right(said("zero_drift", [1]), [], background=slow)
    assert right(said("zero_drift", [1], "class_confirmed", ("drift", [])), [], background=slow)
    assert right(said("payload_error", None), [], payload_wrong=True)
    assert not right(said("payload_error", None), [])


@pytest.mark.parametrize(
    ("moved", "own"), [("random_walk", "random_walk"), ("column_bending", "thermal_drift"), (None, "thermal_drift")]
)
def test_of_a_station_that_moved_the_class_is_right_and_a_member_only_where_it_moved_so(
    moved: str | None, own: str
) -> None:
    truth = {"kind": "walk", "id": moved}
    for name in ("drift", "random_walk", "base_step"):
        assert right({**said(name, None), "claim": {"said": "class"}}, [], background=truth)
        member = {**said(name, None), "claim": {"said": "member"}}
        assert right(member, [], background=truth) == (name == own)
        assert not right(member, [])
    assert right({**said(own, None), "claim": {"said": "member"}}, [], background=truth)


def test_a_step_beside_a_walk_is_of_its_class_and_no_name_where_nothing_is_hidden() -> None:
    walk = record([said("base_step", None, "provisional")], [], "no_gap")
    walk["truth"]["background"] = {"kind": "walk", "id": "random_walk"}
    still = record([said("base_step", None, "provisional")], [], "no_gap")
    found = {f.title: f for f in figures([walk, still])}
    assert (found["– the same, repeats drifting"].k, found["– the same, repeats stable"].k) == (0, 1)


def test_a_smooth_curve_may_be_called_one_but_not_by_a_cause() -> None:
    truth = [hidden("hose_torque", [3])]
    assert not right(said("eccentricity", [3]), truth)
    assert not right(said("eccentricity", [3], "class_confirmed", ("encoder_scale", [3])), truth)
    assert right(said("eccentricity", [3], "class_confirmed", ("unknown_joint_curve", [3])), truth)
    assert not right(said("eccentricity", [2], "class_confirmed", ("unknown_joint_curve", [2])), truth)
    assert right({**said("eccentricity", [3], "class_confirmed"), "class": "smooth error of joint 3"}, truth)


def test_the_class_of_a_moved_zero_holds_the_links_beside_the_joint() -> None:
    claim = {"claim": {"said": "class"}, "physical_class": {"id": "joint_zero"}, "alias_set": []}
    truth = [hidden("link_bow", [3])]
    for joint, holds in ((2, False), (3, True), (4, True), (5, False)):
        assert right({**said("zero_drift", [joint], "class_confirmed"), **claim}, truth) is holds
    assert not right({**said("zero_drift", [4]), **claim, "claim": {"said": "member"}}, truth)


def test_an_exact_set_is_all_that_is_hidden_and_nothing_else() -> None:
    truth = [hidden("backlash", [3]), hidden("eccentricity", [1])]
    both = [said("backlash", [3]), said("eccentricity", [1], "provisional")]
    assert exact(record(both, truth, "named"))
    assert not exact(record(both[:1], truth, "named"))
    assert not exact(record([*both, said("drift", None)], truth, "named"))
    moved = record([*both, said("drift", None)], truth, "named")
    moved["truth"]["background"] = {"kind": "linear"}
    assert exact(moved)


@pytest.mark.parametrize(
    ("lam", "rho", "amplitudes", "freedom"), [(30.0, 0.5, 1, 60.0), (60.0, 0.8, 1, 12.0), (44.0, 0.0, 6, 30.0)]
)
def test_an_ideal_test_names_what_simulated_tests_name(lam: float, rho: float, amplitudes: int, freedom: float) -> None:
    rng, draws = np.random.default_rng(5), 40_000
    seen = 0.75 * lam  # a quarter of 60 poses chooses nothing

    def taken(shift: float) -> np.ndarray:
        noise = rng.normal(size=(amplitudes, draws))
        noise[0] += shift
        return np.sum(noise**2, axis=0) / (rng.chisquare(freedom, draws) / freedom)

    best = np.max([taken(0.0) for _ in range(100)], axis=0)
    shown = taken(math.sqrt(seen)) > np.quantile(best, 0.99)
    # Of a signature of length one and a rival like it: the better of the two is the one whose prediction lies nearer.
    y = rng.normal(size=draws)
    truer = np.abs(y) < np.abs(y - math.sqrt(seen * (1.0 - rho)))
    r = record([], [], "named")
    r["report"]["noise"]["freedom"] = freedom
    one = hidden("backlash", list(range(1, amplitudes + 1))) | {"lam_partial": lam, "rho": rho}
    assert ideal(r, one) == pytest.approx(float(shown.mean() * truer.mean()), abs=0.012)


def test_bounds_by_pose_know_that_coordinates_hang_together() -> None:
    apart = by_pose("x", "", [(3, 3)] * 95 + [(0, 3)] * 5)
    assert (apart.k, apart.n) == (285, 300)
    low, high = apart.bounds()
    assert low < clopper_pearson(285, 300)[0]
    assert high > clopper_pearson(285, 300)[1]
    assert by_pose("x", "", [(1, 1)] * 95 + [(0, 1)] * 5).bounds() == pytest.approx(clopper_pearson(95, 100), abs=1e-6)
    assert by_pose("x", "", []).row() == "| x |  | – | 0 | |"


def test_undecidable_must_be_said() -> None:
    pair = [("axial_compliance", [2]), ("link_bending", [1])]

    def report(verdict: str, *effects: dict[str, Any]) -> dict[str, Any]:
        return {"verdict": verdict, "effects": list(effects), "not_testable": []}

    assert not said_undecidable(report("closed", said("axial_compliance", [2])), pair)
    held = said("link_bending", [1], "class_confirmed", ("axial_compliance", [2]))
    assert said_undecidable(report("closed", held), pair)
    other = said("drift", None, "class_confirmed", ("session_shift", []))
    assert not said_undecidable(report("closed", other), pair)
    assert said_undecidable(report("unexplained", said("unknown_field", None, "provisional")), pair)
    assert not said_undecidable(report("no_gap"), pair)
    one = [("backlash", [2])]
    listed = {**report("no_gap"), "not_testable": [{"id": "backlash", "joints": None}]}
    assert not said_undecidable(report("no_gap"), one)
    assert said_undecidable(listed, one)
    assert not said_undecidable({**listed, "effects": [said("backlash", [2], "provisional")]}, one)


def test_figures_count_what_they_say() -> None:
    effect = said("backlash", [3])
    effect["parameters"] = [{"name": "backlash_3", "unit": "deg", "interval_low": 0.005, "interval_high": 0.006}]
    records = [
        record([], [], "no_gap"),
        record([said("drift", None, "provisional")], [], "no_gap"),
        record([effect], [hidden("backlash", [3])], "named"),
        record([said("eccentricity", [1])], [hidden("backlash", [3])], "named"),
        record([said("unknown_joint_curve", [2], "provisional")], [hidden("third_harmonic", [2])], "outside"),
        {**record([], [], "no_gap"), "report": None, "error": "not_converged: no"},
    ]
    found = {f.title: f for f in figures(records)}
    count = {title: (f.k, f.n) for title, f in found.items()}
    assert count["any name when nothing is hidden"] == (1, 2)
    assert count["confirmed when nothing is hidden"] == (0, 2)
    assert count["confirmed but wrong, of confirmed names"] == (1, 2)
    assert count["power: a gap is named at λ ≥ 30"] == (2, 2)
    assert count["exact name at λ ≥ 30 and λ(1−ρ) ≥ 11"] == (1, 2)
    assert count["– the same, smooth and outside cases alone"] == (0, 1)
    assert count["95 % intervals of parameters that hold the truth"] == (1, 1)
    assert count["exact hidden set, 1 decidable"] == (1, 2)
    assert count["runs that failed"] == (1, 6)
    assert closure(records[:1]) == pytest.approx(1.0)


def test_rows_of_the_table_say_when_there_is_nothing_to_say() -> None:
    assert Figure("a", "b").row() == "| a | b | – | 0 | |"
    assert "–" in Figure("a", "b", value=math.nan).row()
    assert Figure("a", "≤ 1 %", 1, 100).row() == "| a | ≤ 1 % | 1.0% (1) | 100 | 0.0% – 5.4% |"
