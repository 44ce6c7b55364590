from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.robot import Payload
from kilter_core.errors import OptionError
from kilter_core.gap import find_gap, plan_separation
from kilter_core.gap.evidence.similarity.testability import testability as judged
from kilter_core.gap.options import GapOptions
from kilter_core.gap.report.next_poses import Proposal, _Question, proposal_rows, separate
from kilter_core.gap.report.separation import (
    are_never_separable,
    assess_separation,
    simulate_first_campaign,
    undecided_effect_pair,
)
from kilter_core.gap.search.candidates import with_testable
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana


@pytest.fixture(scope="module")
def asked():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(2.0,))
    p = prepare_data(Calibration.nominal(robot), rows, GapOptions())
    candidates = with_testable(p.library, judged(p.problem, p.library).able)
    by = {c.label: c for c in candidates}
    return p, by["axial_compliance j2"], by["link_bending j2"]


def test_chosen_poses_tell_more_than_random_ones(asked):
    p, target, rival = asked
    rows = p.visits.observations
    proposals = separate(p.problem, rows, target, [rival], (), np.array([1e-4]), 8, 0)
    new = next(x for x in proposals if x.kind == "new")
    question = _Question(p.problem, target, rival.columns, (), np.array([1e-4]))
    X = question.rows(rows.select(slice(0, 8)))
    H = question.information() + np.einsum("vmi,vmj->ij", X, X)
    random = 1.0 / np.linalg.inv(H)[0, 0]
    assert new.after[-1] - new.before > 3.0 * (random - new.before)
    assert list(new.after) == sorted(new.after)


def test_old_poses_under_another_load_are_weighed_against_new_ones(asked):
    p, target, rival = asked
    first, second = separate(p.problem, p.visits.observations, target, [rival], (), np.array([1e-4]), 6, 0)
    assert {first.kind, second.kind} == {"new", "repeat"}
    repeat = first if first.kind == "repeat" else second
    assert repeat.change.startswith("repeat these poses")
    assert first.after[-1] > 0.9 * second.after[-1]
    seen = {tuple(np.round(q, 9)) for q in p.visits.observations.q}
    assert {tuple(np.round(q, 9)) for q in repeat.rows.q} <= seen


def test_proposed_poses_stay_within_the_limits(asked):
    p, target, rival = asked
    proposals = separate(p.problem, p.visits.observations, target, [rival], (), np.array([1e-4]), 5, 0)
    limits = np.degrees(katana().limits)
    for row in proposal_rows(proposals, ("a", "b"), katana()):
        assert np.all(np.array(row["q_deg"]) >= limits[:, 0])
        assert np.all(np.array(row["q_deg"]) <= limits[:, 1])
        assert row["separates"] == ["a", "b"]


def test_a_plan_for_two_named_effects():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(2.0,))
    plan = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=4)
    assert plan.labels == ("axial_compliance j2", "link_bending j2")
    assert 0.5 < plan.alike <= 1.0
    for proposal in plan.proposals:
        assert len(proposal.rows) == len(proposal.after) == 4
        assert proposal.after[-1] > proposal.after[0] > proposal.before


def test_what_cannot_act_is_refused_with_the_reason():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(2.0,))
    with pytest.raises(OptionError, match="no load moment acts there, so no pose can show it"):
        plan_separation(robot, rows, ("axial_compliance", (0,)), ("link_bending", (1,)))
    with pytest.raises(OptionError, match="no session"):
        plan_separation(robot, rows, ("session_shift", None), ("drift", None))
    with pytest.raises(OptionError, match=r"It acts at joints \[1, 2, 3, 4, 5\]"):
        plan_separation(robot, rows, ("eccentricity", (0, 3)), ("drift", None))


def test_what_was_confirmed_can_be_planned_for_with_the_version_that_holds_it():
    robot = katana()
    rows = campaign(robot, [("axial_compliance", (1, 2), (2e-4, 1e-4))], seed=1, poses=60, loads=(2.0,))
    found = find_gap(robot, rows, GapOptions(effects=("axial_compliance", "eccentricity"), resamples=5, permutations=2))
    start = found.calibration
    assert "compliance_2" in start.names
    plan = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=3, start=start)
    assert plan.labels[0] == "axial_compliance j2"
    # The amount is the version's: twice as large an effect is told four times as well by the same poses.
    values = start.values.copy()
    values[start.names.index("compliance_2")] *= 2.0
    double = replace(start, values=values)
    again = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=3, start=double)
    assert again.proposals[0].before == pytest.approx(4.0 * plan.proposals[0].before, rel=0.05)


def test_what_a_report_left_undecided_is_planned_for():
    row = {"id": "axial_compliance", "joints": [2], "verdict": "class_confirmed", "empirical": False}
    rival = {"id": "link_bending", "joints": [2], "correlation": 0.97}
    same = {"id": "friction_windup", "joints": [1], "correlation": 1.0}
    assert undecided_effect_pair({"effects": [{**row, "alias_set": [same, rival]}]}) == (
        ("axial_compliance", (1,)),
        ("link_bending", (1,)),
    )
    assert undecided_effect_pair({"effects": [{**row, "alias_set": [same]}]}) is None  # no pose tells those apart
    weak = {**row, "verdict": "provisional", "alias_set": []}
    assert undecided_effect_pair({"effects": [weak]}) == (("axial_compliance", (1,)), None)
    assert undecided_effect_pair({"effects": []}) is None


def test_a_slide_is_given_in_mm():
    robot = katana()
    slide = replace(robot, joints=(replace(robot.joints[0], kind="prismatic"), *robot.joints[1:]))
    rows = campaign(robot, poses=2, revisits=0)
    proposal = Proposal(rows, "new", "", 1.0, (2.0, 3.0))
    first = proposal_rows([proposal], ("a", "b"), slide)[0]["q_deg"]
    assert first[0] == pytest.approx(1e3 * rows.q[0, 0], abs=1e-3)
    assert first[1] == pytest.approx(np.degrees(rows.q[0, 1]), abs=1e-3)


def test_loads_that_hang_off_the_tool_point_are_asked_for_where_they_hung():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(0.5, 2.0))
    place = np.where(rows.payload_kg[:, None] > 1.0, [0.01, 0.0, 0.04], [0.0, 0.02, 0.0])
    p = prepare_data(Calibration.nominal(robot), replace(rows, payload_com=place), GapOptions())
    by = {c.label: c for c in with_testable(p.library, judged(p.problem, p.library).able)}
    target, rival = by["axial_compliance j2"], by["link_bending j2"]
    proposals = separate(p.problem, p.visits.observations, target, [rival], (), np.array([1e-4]), 8, 0)
    said = {(row["payload_kg"], *row["payload_com_mm"]) for row in proposal_rows(proposals, ("a", "b"), robot)}
    assert said
    assert said <= {(0.5, 0.0, 20.0, 0.0), (2.0, 10.0, 0.0, 40.0)}


def test_a_plan_without_campaigns_carries_the_default_load():
    robot = replace(katana(), load=Payload(0.5, (0.0, 0.0, 0.04)))
    rows = simulate_first_campaign(Calibration.nominal(robot), GapOptions())
    assert np.unique(rows.payload_kg).tolist() == [0.5]
    assert np.unique(rows.payload_com, axis=0).tolist() == [[0.0, 0.0, 0.04]]
    assert simulate_first_campaign(Calibration.nominal(katana()), GapOptions()).payload_com is None


@pytest.fixture(scope="module")
def library():
    rows = campaign(katana(), seed=1, poses=40, loads=(0.0,))
    p = prepare_data(Calibration.nominal(katana()), rows, GapOptions())
    return {c.label: c for c in p.library.candidates}


def told(library, pair, after, rows=None, robot=None):
    """What 12 poses say that bring what is known from 4 to ``after``."""
    robot = robot or katana()
    rows = campaign(robot, seed=1, poses=40, loads=(0.0,)) if rows is None else rows
    proposal = Proposal(Observations(np.zeros((12, 5))), "new", "", 4.0, tuple(np.linspace(4.0, after, 12)))
    one, other = (library[label] for label in pair)
    said = assess_separation([proposal], one, other, rows, robot)
    assert said is not None
    return said


def test_poses_that_cannot_decide_are_said_to_and_how_many_would(library):
    pair = ("axial_compliance j2", "eccentricity j2")
    none = told(library, pair, 4.2)  # 12 (22 - 4) / 0.2 = 1080 poses
    assert (none.enough, none.needed, none.factor) == (False, None, pytest.approx(1.05))
    assert none.sentence.startswith(
        "12 poses will not tell axial_compliance j2 from eccentricity j2 (the factor of information after all of them is "
        "1.05); no number of poses like these would. Do this instead: "
    )
    some = told(library, pair, 10.0)
    assert some.needed == 36
    assert "about 36 such poses would" in some.sentence
    assert [w["code"] for w in some.warnings()] == ["poses_will_not_tell"]
    assert some.to_document()["instead"] == list(some.instead)
    enough = told(library, pair, 40.0)
    assert (enough.enough, enough.needed, enough.instead, list(enough.warnings())) == (True, 12, (), [])
    assert enough.sentence.startswith("12 poses will tell axial_compliance j2 from eccentricity j2")
    assert (
        assess_separation([], library[pair[0]], library[pair[1]], campaign(katana(), poses=5, revisits=0), katana())
        is None
    )


def test_what_does_instead_is_what_only_one_of_the_two_shows(library):
    robot = katana()
    compliance = ("axial_compliance j2", "eccentricity j2")
    assert told(library, compliance, 4.2).instead[0].startswith("repeat old poses with a second known payload")
    two = campaign(robot, seed=1, poses=40, loads=(0.0, 2.0))
    assert told(library, compliance, 4.2, two).instead[0].startswith("repeat old poses with a heavier known payload")
    both = told(library, ("axial_compliance j2", "link_bending j2"), 4.2).instead
    assert not any("payload, which" in one for one in both)  # both follow it
    assert any("a link-side encoder of joint 2, which sees only axial_compliance j2" in one for one in both)
    assert not any("inclinometer" in one for one in both)  # behind joint 2 it would see both
    behind = next(label for label in library if label.startswith("link_torsion"))  # of the class of the gear's twist
    encoder = "read a link-side encoder of joint 2, which sees only axial_compliance j2"
    assert encoder in told(library, (behind, "axial_compliance j2"), 4.2).instead
    further = told(library, ("link_bending j2", "axial_compliance j4"), 4.2).instead
    assert "read an inclinometer behind joint 2, which tilts with link_bending j2 alone" in further
    curves = ("eccentricity j2", "second_harmonic j2")
    short = told(library, curves, 4.2).instead
    assert short[0].startswith(
        "for eccentricity j2, move the joint over more than 180 degrees"
    )  # it cannot make a turn
    turning = replace(robot.joints[1], lower=-3.5, upper=3.5)
    free = replace(robot, joints=(robot.joints[0], turning, *robot.joints[2:]))
    assert told(library, curves, 4.2, robot=free).instead == (
        "move joint 2 through a full turn, after which a true error of the joint repeats",
    )


def test_no_poses_are_asked_for_that_no_name_would_follow(library):
    """Curves of a joint that cannot make a turn stay one class, however many poses: 18 more "would tell" two of them."""
    robot = katana()
    turning = replace(robot.joints[1], lower=-3.5, upper=3.5)
    free = replace(robot, joints=(robot.joints[0], turning, *robot.joints[2:]))
    pair = library["eccentricity j2"], library["second_harmonic j2"]
    assert are_never_separable(*pair, robot)
    assert not are_never_separable(*pair, free)
    assert not are_never_separable(library["eccentricity j2"], library["axial_compliance j2"], robot)
    assert not are_never_separable(library["eccentricity j2"], library["second_harmonic j3"], robot)


def test_a_plan_says_whether_its_poses_tell_the_two_apart():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(2.0,))
    plan = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=2)
    assert plan.told is not None
    assert (plan.told.poses, plan.told.names) == (2, plan.labels)
    assert plan.told.enough == (max(p.after[-1] for p in plan.proposals) >= 22.0)
    assert plan_separation(robot, rows, ("axial_compliance", (1,)), count=2).told is None  # from geometry: made surer
