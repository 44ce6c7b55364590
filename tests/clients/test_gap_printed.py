"""What the gap command prints of a result: what is missing, and gains that only weighing shows."""

from __future__ import annotations

from typing import Any

import pytest

from kilter_client.cli.reports.gap_report import show_gap
from kilter_client.results.shown_jobs import ShownSearch
from kilter_service.contract.gap_details import NamedEffect
from kilter_service.contract.gap_details import Untestable as Row
from kilter_service.contract.jobs.gap import GapOptions, GapResult
from kilter_service.page.gap.effects import claim_from_effect
from kilter_service.page.gap.story import candidates, untestable

GAP = {"lengths": "at_tool", "before_mm": 0.235, "after_mm": 0.0505, "noise_mm": 0.0304, "noise_rms_mm": 0.0527}
WALK = {"id": "random_walk", "joints": None, "verdict": "provisional", "gain_mm": -0.006, "p_value": 1e-9}
UNTESTABLE = [
    {"id": "drift", "joints": None, "reason": "no t", "remedy": "revisit a pose", "missing": "columns: t_s"},
    {"id": "settling", "joints": None, "reason": "no t", "remedy": "revisit it often", "missing": "columns: t_s"},
    {"id": "backlash_load", "joints": [1], "reason": "none acts", "remedy": "two loads", "missing": "a load moment"},
]


def printed(capsys: pytest.CaptureFixture[str], **more: Any) -> str:
    show_gap({"verdict": "closed", "sentence": "", "gap": GAP, **more})
    return capsys.readouterr().out


def test_effects_that_wait_for_the_same_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, not_testable=UNTESTABLE).splitlines()
    assert "  columns: t_s: drift, settling" in lines
    assert "  a load moment: backlash_load j1" in lines
    assert "    how to test it: two loads" in lines
    groups = untestable([Row(**row) for row in UNTESTABLE])
    assert [len(group) for group in groups.values()] == [2, 1]


def test_poses_that_do_not_tell_are_said_to_once_and_where_they_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    sentence = "2 poses will not tell a from b (the factor of information after all of them is 1.05); turn joint 2."
    poses = [{"kind": "new", "change": None, "separates": ["a", "b"], "information_factor": f} for f in (1.02, 1.05)]
    warning = {"code": "poses_will_not_tell", "message": sentence}
    out = printed(capsys, next_poses=poses, told_apart={"sentence": sentence}, warnings=[warning])
    asked = out.splitlines().index("Measure next (2 poses):")
    assert out.splitlines()[asked + 1 : asked + 3] == [
        "  new poses: 2, to tell a from b, information times 1.05 after all",
        f"  {sentence}",
    ]
    assert out.count(sentence) == 1


def test_a_gain_of_weighed_errors_is_said_to_be_one(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys, effects=[WALK])
    assert "random_walk adds 0.006 to the plain rms error" in out
    plain = printed(capsys, effects=[WALK | {"gain_mm": 0.006}])
    assert "plain rms error" not in plain
    (row,) = candidates(GapResult(effects=[NamedEffect(**WALK)]), GapOptions(), "mm")
    assert "adds 0.00600 mm to the plain rms error" in row.reason


def test_the_library_prints_lengths_in_space_beside_lengths_in_space() -> None:
    class Search(ShownSearch):
        headline = GapResult.model_validate({"verdict": "closed", "gap": GAP, "noise": {"absolute": True}}).headline

    said = Search()._line()
    assert "0.23 -> 0.051 mm rms. Measurement noise: 0.053 mm." in said
    assert "0.030" not in said


def test_lengths_by_views_are_said_to_be_beside_how_far_the_tool_moves(capsys: pytest.CaptureFixture[str]) -> None:
    by_views, moving = GAP | {"lengths": "by_views"}, WALK | {"gain_mm": 1.57, "moves_mm": 0.158}

    said = GapResult.model_validate({"verdict": "closed", "gap": by_views}).headline
    assert "0.23 -> 0.051 mm by views rms" in str(said)
    out = printed(capsys, gap=by_views, effects=[moving])
    assert "gain mm by views   moves mm" in out
    assert "1.57               0.158" in out
    assert "rms mm by views" in out
    assert "moves are at the tool" in out
    assert "by views" not in printed(capsys, effects=[moving])


def test_what_revisits_say_is_told_beside_the_effect_that_they_bear_out(capsys: pytest.CaptureFixture[str]) -> None:
    told = "15 poses revisited at other times vary by 0.13 ± 0.006 mm, and the other poses predict 0.12 mm"
    order = {"name": "order", "words": "poses revisited", "met": True, "number": 14.0, "told": told}
    walk = WALK | {"claim": {"said": "member", "words": "random walk", "evidence": [order]}}
    assert f"  random_walk: {told}\n" in printed(capsys, effects=[walk])
    assert f"{told}." in claim_from_effect(NamedEffect(**walk)).remarks
    unmet = walk | {"claim": walk["claim"] | {"evidence": [order | {"met": False}]}}
    assert told not in printed(capsys, effects=[unmet])


def test_the_joints_at_which_both_halves_name_an_effect_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    halves = {"named": [True, True], "apart_sigma": 0.7, "joints": [2, 5]}
    play = {"id": "backlash", "joints": [2, 4, 5], "verdict": "class_confirmed", "gain_mm": 0.2, "p_value": 1e-9}
    assert "; both name it at joint 2, 5\n" in printed(capsys, effects=[play | {"halves": halves}])
    assert "Both name it at joint 2, 5." in " ".join(claim_from_effect(NamedEffect(**play, halves=halves)).remarks)
    nowhere = play | {"halves": halves | {"joints": []}}
    assert "at no joint do both name it" in printed(capsys, effects=[nowhere])
    assert "at the same joint nowhere" in " ".join(claim_from_effect(NamedEffect(**nowhere)).remarks)
    one = play | {"joints": [2], "halves": halves | {"joints": [2]}}
    assert "both name it at" not in printed(capsys, effects=[one])
    earlier = play | {"halves": {key: value for key, value in halves.items() if key != "joints"}}
    assert "both name it at" not in printed(capsys, effects=[earlier])


def test_what_cannot_be_told_apart_is_printed_with_its_sum(capsys: pytest.CaptureFixture[str]) -> None:
    said = "d_2 cannot be told from d_3. Together they are known: d_2 + d_3 = 164.1 mm (95 %: 163.9 to 164.3)."
    members = [{"name": "d_2", "weight": 1.0}, {"name": "d_3", "weight": -1.0}]
    lines = printed(capsys, null_directions=[{"parameters": members, "sentence": said}]).splitlines()
    assert lines[lines.index("What these data cannot distinguish:") + 1] == f"  - {said}"
    assert "What these data cannot distinguish:" not in printed(capsys)
