from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.errors import OptionError
from core.gap import plan_separation
from core.gap.candidates import with_testable
from core.gap.next_poses import Proposal, _Question, rows_of, separate
from core.gap.options import GapOptions
from core.gap.prepare import Workshop
from core.gap.testability import testability as judged
from core.model import Calibration
from tests.core.gap.simulated import campaign, katana


@pytest.fixture(scope="module")
def asked():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(2.0,))
    p = Workshop(Calibration.nominal(robot), rows, GapOptions(), lambda f, s: None).run()
    candidates = with_testable(p.library, judged(p.world, p.library).able)
    by = {c.label: c for c in candidates}
    return p, by["axial_compliance j2"], by["link_bending j2"]


def test_chosen_poses_tell_more_than_random_ones(asked):
    p, target, rival = asked
    rows = p.visits.observations
    proposals = separate(p.world, rows, target, [rival], (), np.array([1e-4]), 8, 0)
    new = next(x for x in proposals if x.kind == "new")
    question = _Question(p.world, target, rival.columns, (), np.array([1e-4]))
    X = question.rows(rows.select(slice(0, 8)))
    H = question.information() + np.einsum("vmi,vmj->ij", X, X)
    random = 1.0 / np.linalg.inv(H)[0, 0]
    assert new.after[-1] - new.before > 3.0 * (random - new.before)
    assert list(new.after) == sorted(new.after)


def test_old_poses_under_another_load_are_weighed_against_new_ones(asked):
    p, target, rival = asked
    first, second = separate(p.world, p.visits.observations, target, [rival], (), np.array([1e-4]), 6, 0)
    assert {first.kind, second.kind} == {"new", "repeat"}
    repeat = first if first.kind == "repeat" else second
    assert repeat.change.startswith("repeat these poses")
    assert first.after[-1] > 0.9 * second.after[-1]
    seen = {tuple(np.round(q, 9)) for q in p.visits.observations.q}
    assert {tuple(np.round(q, 9)) for q in repeat.rows.q} <= seen


def test_proposed_poses_stay_within_the_limits(asked):
    p, target, rival = asked
    proposals = separate(p.world, p.visits.observations, target, [rival], (), np.array([1e-4]), 5, 0)
    limits = np.degrees(katana().limits)
    for row in rows_of(proposals, ("a", "b"), katana()):
        assert np.all(np.array(row["q_deg"]) >= limits[:, 0])
        assert np.all(np.array(row["q_deg"]) <= limits[:, 1])
        assert row["separates"] == ["a", "b"]


def test_a_plan_for_two_named_effects():
    robot = katana()
    rows = campaign(robot, seed=1, poses=40, loads=(2.0,))
    planned = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=4)
    assert len(planned) == 8
    assert planned[3]["information_factor"] > planned[0]["information_factor"] > 1.0
    with pytest.raises(OptionError, match="cannot show axial_compliance"):
        plan_separation(robot, rows, ("axial_compliance", (0,)), ("link_bending", (1,)))


def test_a_slide_is_given_in_mm():
    robot = katana()
    slide = replace(robot, joints=(replace(robot.joints[0], kind="prismatic"), *robot.joints[1:]))
    rows = campaign(robot, poses=2, revisits=0)
    proposal = Proposal(rows, "new", "", 1.0, (2.0, 3.0))
    first = rows_of([proposal], ("a", "b"), slide)[0]["q_deg"]
    assert first[0] == pytest.approx(1e3 * rows.q[0, 0], abs=1e-3)
    assert first[1] == pytest.approx(np.degrees(rows.q[0, 1]), abs=1e-3)
