"""How much is claimed: poses that took no part in choosing, a confirmation of another day, sizes that matter."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.guarded import Guarded
from kilter_core.gap.evidence.held_out import practical_size
from kilter_core.gap.evidence.held_out.adequacy import Adequacy
from kilter_core.gap.evidence.held_out.practical_size import Misfit
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit
from kilter_core.gap.evidence.replication import Confirmation, Replication, replication
from kilter_core.gap.evidence.similarity.testability import testability as judged
from kilter_core.gap.evidence.verdict import Evidence, run_verdict, sentence
from kilter_core.gap.report.report import Remains
from kilter_core.gap.report.stored import build_stored_version
from kilter_core.gap.search.candidates import with_testable
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import refit
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.search.scan import Scorer, null_distribution
from kilter_core.gap.search.select import Selector
from kilter_core.gap.study import held_out, split_held_out_rows
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.shared_rows import shared_rows
from tests.core.gap.simulated import campaign, katana

EFFECTS = ("eccentricity", "encoder_scale", "second_harmonic", "axial_compliance", "backlash")
QUICK = GapOptions(effects=EFFECTS, resamples=20, permutations=10, bootstraps=499, next_poses=0)
CURVE = ("second_harmonic", (4,), (8e-4, 5e-4))


@pytest.fixture(scope="module")
def robot():
    return katana()


@pytest.fixture(scope="module")
def small(robot):
    """Forty poses: too few to spare any."""
    return campaign(robot, [CURVE], poses=40, revisits=12, seed=1, arm=1)


def again(robot, hidden, seed=2, poses=30):
    """Another day: base and tool set up anew, the same arm."""
    return campaign(robot, hidden, poses=poses, revisits=10, seed=seed, arm=1)


def test_a_quarter_of_sixty_poses_is_held_out_and_none_of_fewer(robot):
    rows = campaign(robot, poses=60, revisits=20)
    inside, outside = held_out(rows, None, 0)
    assert sorted([*inside, *outside]) == list(range(len(rows)))
    held = set(rows.pose_id[outside])
    assert len(held) == 15
    assert not held & set(rows.pose_id[inside])
    assert len(held & set(range(20))) == 5  # of the repeated poses no more than of the others
    fewer = campaign(robot, poses=59)
    assert len(held_out(fewer, None, 0)[1]) == 0
    assert len(held_out(rows, 0.0, 0)[1]) == 0
    with pytest.raises(OptionError, match=r"validation is 1\.5"):
        held_out(rows, 1.5, 0)


def test_only_poses_that_did_not_choose_confirm(robot):
    rows = campaign(robot, [CURVE], poses=80, seed=1)
    held, chosen_by_all = find_gap(robot, rows, QUICK), find_gap(robot, rows, QUICK, validation=0)
    (first,), (second,) = held.effects, chosen_by_all.effects
    assert (first.verdict, second.verdict) == ("class_confirmed", "provisional")
    assert [name for name, passed in second.gates.items() if not passed] == ["unseen_poses"]
    row = chosen_by_all.to_document()["effects"][0]
    assert "a quarter is then held out" in row["to_confirm"][0]
    assert held.gap["held_out"] == "validation observations"
    assert chosen_by_all.gap["held_out"] == "leave one pose out"


def test_held_out_coordinates_lie_within_their_predictive_intervals(robot):
    inside = total = 0
    for seed in range(4):
        report = find_gap(robot, campaign(robot, [CURVE], poses=80, seed=seed), QUICK)
        told = report.predictive
        assert told["of"] == sum(n for _, n in told["poses"]) > 0
        assert told["inside"] == sum(k for k, _ in told["poses"])
        inside, total = inside + told["inside"], total + told["of"]
    assert total > 250
    assert 0.88 < inside / total < 0.99
    assert find_gap(robot, campaign(robot, [CURVE], poses=50), QUICK).predictive is None


def test_one_broken_beam_among_the_held_out_poses_decides_nothing(robot):
    rows = campaign(robot, [CURVE], poses=80, seed=1)
    clean = find_gap(robot, rows, QUICK)
    broken = replace(rows, position=rows.position.copy())
    inside, outside = held_out(rows, None, 0)
    broken.position[outside[3]] += 2e-3
    report = find_gap(robot, broken, QUICK)
    assert report.gap["held_out_set_aside"] == 1
    (named,) = report.to_document()["held_aside"]
    assert named["row"] == outside[3]  # of the rows that were given, searched and held out
    assert named["residual_mm"] == pytest.approx(2.0 * 3**0.5, rel=0.05)
    assert named["residual_sigma"] == pytest.approx(named["residual_mm"] / report.gap["noise_mm"])
    told = report.stored.metrics(broken.select(inside), broken.select(outside), report.spikes)["validation"]
    assert (told["n"], told["left_out"]) == (len(outside) - 1, 1)
    assert told["identified"]["rms_mm"] == pytest.approx(report.gap["validation_after_mm"], rel=0.02)
    assert [j.verdict for j in report.effects] == [j.verdict for j in clean.effects] == ["class_confirmed"]
    assert report.gap["closure"] == pytest.approx(clean.gap["closure"], abs=0.1)


def test_what_is_seen_again_with_the_same_amplitude_is_replicated(robot, small):
    alone = find_gap(robot, small, QUICK)
    assert [j.verdict for j in alone.effects] == ["provisional"]
    report = find_gap(robot, small, QUICK, confirmation=again(robot, [CURVE]))
    (effect,) = report.effects
    assert effect.verdict == "replicated"
    # Seen again is the shape; the joint did not make a turn, so it is still no more than its class.
    assert effect.claim.words == "error curve of joint 5, in the shape of second harmonic"
    told = report.to_document()["effects"][0]["replication"]
    assert told["outcome"] == "replicated"
    assert told["p_value"] < 0.01
    for row, true in zip(told["parameters"], CURVE[2], strict=True):
        assert np.radians(row["value"]) == pytest.approx(true, abs=4 * np.radians(row["sigma"]))
    assert told["with_mm"] < told["without_mm"]
    assert "confirmation_worse" not in {w["code"] for w in report.warnings}
    json.dumps(report.to_document(), allow_nan=False)


def test_a_confirmation_without_the_effect_contradicts_it(robot, small):
    report = find_gap(robot, small, QUICK, confirmation=again(robot, []))
    (effect,) = report.effects
    assert effect.evidence.replication.outcome == "contradicted"
    told = report.to_document()["effects"][0]["replication"]
    assert told["with_mm"] > told["without_mm"]
    assert effect.verdict == "contradicted"
    assert not report.calibration.model.effects
    assert not effect.gates["confirmation"]
    assert "contradicted, and left out of the version." in report.sentence
    # Without it the version is what predicts the confirmation better.
    assert not report.calibration.model.effects
    assert "confirmation_worse" not in {w["code"] for w in report.warnings}


def test_a_law_of_time_stays_behind_where_the_confirmation_has_another_clock(robot):
    drift = ("zero_drift", (1,), (3e-7,))
    rows = campaign(robot, [drift], poses=60, seed=3, arm=1)
    report = find_gap(
        robot, rows, replace(QUICK, effects=("zero_drift", "eccentricity")), confirmation=again(robot, [])
    )
    effect = next(j for j in report.effects if j.evidence.candidate.id == "zero_drift")
    assert effect.evidence.replication.outcome == "not_testable"
    assert "another clock" in effect.evidence.replication.reason
    assert effect.gates["confirmation"]  # which says nothing against it


def test_a_confirmation_that_cannot_show_the_effect_says_so(robot):
    rows = campaign(robot, [("backlash", (1,), (6e-4,))], poses=45, revisits=15, seed=3, arm=1)
    blind = replace(again(robot, [("backlash", (1,), (6e-4,))]), direction=None)
    (effect,) = find_gap(robot, rows, QUICK, confirmation=blind).effects
    assert effect.evidence.replication.outcome == "not_testable"
    assert "no direction" in effect.evidence.replication.reason
    assert effect.verdict == "provisional"


def forced(robot, rows, rng):
    """A hunt that ended with one candidate drawn at random, whatever the rows say."""
    begin = Calibration.nominal(robot)
    prepared = prepare_data(begin, rows, QUICK)
    problem = prepared.problem
    candidates = with_testable(prepared.library, judged(problem, prepared.library).able)
    scorer = Scorer.from_candidates(candidates, True, problem.settings.noise.freedom)
    selector = Selector(scorer, problem.rows, np.full(len(problem.A), np.inf))
    place = int(rng.integers(len(candidates)))
    fitted = refit(problem.settings, problem.values, list(candidates[place].columns))
    found = SearchResult(fitted, selector, (place,), null_distribution(problem, scorer, [], 19, 0), 1e-4, ())
    return candidates[place], build_stored_version(found, begin, rows, QUICK)


def test_a_name_forced_upon_noise_is_not_seen_again(robot):
    """Fifteen names given to noise, each on arms of its own: 1 % of them may be seen in other noise."""
    rng, outcomes = np.random.default_rng(0), []
    for seed in range(15):
        rows = campaign(robot, poses=40, revisits=12, seed=100 + seed, arm=seed)
        other = campaign(robot, poses=30, revisits=10, seed=500 + seed, arm=seed)
        candidate, kept = forced(robot, rows, rng)
        seen = Confirmation.from_observations(kept.calibration, kept.posterior, other, QUICK, lambda f, s: None)
        outcomes.append(replication(seen, robot, other, candidate, None).outcome)
    assert set(outcomes) <= {"not_seen", "replicated"}
    assert outcomes.count("replicated") <= 2  # more in one of 2000 such tests


def test_a_confirmation_with_rows_of_the_search_is_refused_whatever_its_file(robot, small):
    other = again(robot, [CURVE])
    copied = small.select(np.arange(5))
    shifted = replace(copied, t=copied.t + 1e5, pose_id=copied.pose_id + 900, position=copied.position * (1 + 1e-15))
    mixed = Observations.concatenate([other, shifted])
    with pytest.raises(ObservationError, match=r"5 of \d+ rows for confirmation.*leave these rows out") as refused:
        find_gap(robot, small, QUICK, confirmation=mixed)
    assert refused.value.code == "rows_shared"
    with pytest.raises(ObservationError, match="rows for validation"):
        split_held_out_rows(small, mixed, 0)
    assert len(shared_rows(small, other)) == 0


def test_a_confirmation_of_another_robot_is_refused(robot, small):
    with pytest.raises(ObservationError, match="The confirmation has 6 joints"):
        find_gap(robot, small, QUICK, confirmation=Observations(q=np.zeros((30, 6)), position=np.zeros((30, 3))))
    with pytest.raises(TooFewPosesError, match=r"The confirmation has 3 poses.*at least 6"):
        find_gap(robot, small, QUICK, confirmation=again(robot, [CURVE]).select(np.arange(3)))


def test_a_start_of_another_robot_is_refused(robot, small):
    other = robot_from_document({**preset_document("katana450-chapter5"), "name": "the-other"})
    with pytest.raises(OptionError, match=r"start is a version of robot 'the-other'.*leave start out"):
        find_gap(robot, small, QUICK, start=Calibration.nominal(other))


def test_joints_whose_interval_holds_zero_are_not_seen(robot):
    amounts = (6e-4, 5e-4, 7e-4, 6e-4, 2e-6)
    report = find_gap(robot, campaign(robot, [("backlash", None, amounts)], poses=80, seed=2), QUICK)
    rows = [e for e in report.to_document()["effects"] if e["id"] == "backlash"]
    assert {j for e in rows for j in e["seen_joints"]} == {1, 2, 3, 4}
    for row in rows:
        for p in row["parameters"]:
            assert p["seen"] == (not p["interval_low"] <= 0.0 <= p["interval_high"])


def test_each_gate_tells_the_number_it_was_decided_by(robot):
    shapes = replace(QUICK, effects=(*EFFECTS, "unknown_joint_curve"))
    report = find_gap(robot, campaign(robot, [CURVE], poses=80, seed=1), shapes)
    row = report.to_document()["effects"][0]
    assert set(row["gates"]) <= set(row["evidence"])
    assert row["evidence"]["inclusion"] >= 0.8
    assert row["evidence"]["held_out"] > 2.0
    assert row["evidence"]["no_empirical_alias"] > 6.0
    assert row["evidence"]["adequate"] == report.adequacy.p_value


def test_a_misfit_below_what_matters_is_no_gap():
    fit = Adequacy(3300.0, 3000.0, 1.1, 1e-4)
    small, large = (Misfit(rms, 1.2 * rms, 0.005, fit.adequate) for rms in (0.003, 0.03))
    assert (small.too_small, large.too_small) == (True, False)
    assert not Misfit(0.0, 0.0, 0.005, fit.adequate).too_small  # too little is left: another fault
    assert not Misfit(0.003, 0.0036, 0.005, True).too_small
    assert small.is_negligible_for_effect(0.1)
    assert not small.is_negligible_for_effect(0.02)


def test_a_size_that_is_stated_makes_a_curve_too_small_to_matter(robot):
    rows = campaign(robot, [("unknown_joint_curve", (1,), (6e-5, 6e-5))], poses=118, revisits=30, seed=6)
    strict, lax = (find_gap(robot, rows, replace(QUICK, effects=(), matters_um=um)) for um in (0.0, 100.0))
    assert strict.verdict == "unexplained"
    assert lax.verdict in ("closed", "no_gap")
    assert "too small to matter" in lax.sentence.lower()


def test_no_share_is_told_of_a_gap_that_noise_would_leave(robot):
    """Errors before and noise were 0.098 and 0.096 mm on held-out poses: 374 % of the gap were closed."""
    quick = replace(QUICK, effects=("backlash",))
    small, large = (
        find_gap(robot, campaign(robot, [("backlash", (1,), (size,))], poses=160, seed=3), quick)
        for size in (3e-5, 8e-4)
    )
    assert [len(r.effects) for r in (small, large)] == [1, 1]
    assert small.gap["validation_before_mm"] < 1.2 * small.gap["validation_noise_rms_mm"]
    assert small.gap["closure"] is None
    assert large.gap["closure"] == pytest.approx(1.0, abs=0.1)


def told(called: str, verdict: str, moves_mm: float, empirical: bool = False) -> Any:
    """What a sentence reads of an effect that was judged."""
    evidence = SimpleNamespace(moves_mm=moves_mm, candidate=SimpleNamespace(empirical=empirical))
    return SimpleNamespace(
        display_name=called, verdict=verdict, evidence=evidence, gates={"held_out": verdict != "provisional"}
    )


def test_a_shape_that_explains_all_leaves_nothing():
    """The rows agreed with a curve of joint 2, and the headline said "something is left" and "in part it looks like" it."""
    agreed, misfit = Adequacy(300.0, 300.0, 1.0, 0.5), Misfit(0.0, 0.001, 0.005, True)
    curve, play = told("unknown_smooth_curve j2", "provisional", 0.1, True), told("backlash j1", "provisional", 0.1)
    said = sentence("unexplained", (curve, play), agreed, misfit, "")
    assert said.startswith(
        "unknown_smooth_curve j2: of no known cause, but with this shape the model agrees with the rows"
    )
    assert said.endswith("backlash j1: likely, but not every test was passed.")
    beside = sentence("unexplained", (told("base_step", "confirmed", 0.2), curve, play), agreed, misfit, "")
    assert beside.startswith("base_step: confirmed. unknown_smooth_curve j2: of no known cause. backlash j1: likely")
    short = Adequacy(500.0, 300.0, 1.7, 1e-6), Misfit(0.05, 0.06, 0.005, False)
    assert sentence("unexplained", (curve,), *short, " (50.0 um)").startswith("Something is left that no known effect")


def test_a_joint_that_moves_less_than_is_left_is_not_claimed_beside_others(monkeypatch):
    """Where 0.12 mm were left, a joint that moved the tool by 0.05 mm was confirmed as one of three with such an error."""
    moved = {0: 0.05e-3, 1: 0.2e-3, 2: 0.13e-3}
    effects = [SimpleNamespace(joints=(j,), parameters=lambda _: (None,)) for j in moved]
    candidate = SimpleNamespace(effects=effects, columns=(0, 1, 2))
    source = SimpleNamespace(observes_tool=True, rms=float, model=SimpleNamespace(robot=None))
    settings = SimpleNamespace(source=source, used=slice(None))
    scorer = SimpleNamespace(candidates=[candidate])
    found: Any = SimpleNamespace(
        selector=SimpleNamespace(scorer=scorer), problem=SimpleNamespace(settings=settings)
    )  # fmt: skip
    monkeypatch.setattr(practical_size, "displacement_by_columns", lambda _, own: Rms(moved[own[0]]))

    def claimed(left_mm: float, joints: tuple[int, ...] = (0, 1, 2)) -> tuple[int, ...]:
        return practical_size.outweighing(found, 0, joints, Misfit(left_mm, left_mm, 0.005, False))

    assert claimed(0.12) == (1, 2)
    assert claimed(0.01) == (0, 1, 2)
    assert claimed(0.5) == (0, 1, 2)  # none does: nothing singles one out
    assert claimed(0.12, (0,)) == (0,)


class Rms(float):
    """A displacement that is its own rms whichever rows are used."""

    def __getitem__(self, _: Any) -> float:
        return float(self)


def test_held_out_rows_refute_a_run_whatever_it_was_called():
    fit = UnseenFit(300.0, 90, 1e-9, 30, 1e-4, 5e-5, 5e-6)
    assert fit.refutes_model
    assert {fit.verdict(was) for was in ("no_gap", "closed", "provisional", "unexplained")} == {"unexplained"}


def test_the_headline_confirms_no_more_than_was_confirmed():
    """A small effect that failed a test stood among those that a closed gap calls confirmed."""
    fit, left = Adequacy(300.0, 300.0, 1.0, 0.5), Misfit(0.0, 0.001, 0.005, True)
    large, small = told("eccentricity j2", "confirmed", 0.2), told("backlash j4", "provisional", 0.002)
    both, alone = (sentence("closed", judged, fit, left, "") for judged in ((large, small), (small,)))
    assert both.startswith("eccentricity j2: confirmed among the causes of the library.")
    assert both.endswith("Too small to matter: backlash j4.")
    assert "confirmed" not in alone
    assert alone.startswith("Nothing that matters is missing")
    assert alone.endswith("Too small to matter: backlash j4.")


def test_one_error_of_a_joint_is_said_once_and_on_one_level():
    """Two shapes of it were "smooth error of joint 6: confirmed as a class" and "smooth error of joint 6: likely" at once."""
    fit, left = Adequacy(500.0, 300.0, 1.7, 1e-6), Misfit(0.05, 0.06, 0.005, False)
    twice = [told("smooth error of joint 6", verdict, 0.1) for verdict in ("class_confirmed", "provisional")]
    said = sentence("unexplained", (*twice, told("backlash j1", "provisional", 0.1)), fit, left, "")
    assert said.count("smooth error of joint 6") == 1
    assert "smooth error of joint 6: confirmed as a class" in said
    assert "backlash j1: likely" in said
    agreed = Adequacy(300.0, 300.0, 1.0, 0.5), Misfit(0.0, 0.001, 0.005, True)
    both = (twice[0], told("smooth error of joint 6", "replicated", 0.1))
    assert sentence("closed", both, *agreed, "").startswith("smooth error of joint 6: confirmed")


def test_nothing_is_known_to_be_missing_or_not_where_the_noise_is_that_of_the_fit():
    """Such a run was `no_gap`, or `closed` with effects too small to matter."""
    alone, drifting = Adequacy(300.0, 300.0, 1.0, None), Adequacy(300.0, 300.0, 1.0, 0.5, most=True)
    shots = Adequacy(600.0, 300.0, 2.0, 1e-6, least=True)
    nothing, little = Misfit(None, None, 0.005, None), told("backlash j1", "confirmed", 0.001)
    assert {run_verdict(named, fit, nothing) for named in ((), (little,)) for fit in (alone, shots)} == {"not_known"}
    assert run_verdict((told("backlash j1", "confirmed", 0.1),), alone, nothing) == "provisional"
    assert run_verdict((), drifting, nothing) == "no_gap"  # no more is left than a bound that owes nothing to the model
    said = sentence("not_known", (), alone, nothing, "")
    assert said.startswith("Whether something is missing is not known")


def test_noise_of_repeats_that_may_hold_drift_is_not_called_that_of_the_fit():
    nothing = Misfit(0.0, 0.001, 0.005, None)
    drifting, alone = Adequacy(300.0, 300.0, 1.0, 0.5, most=True), Adequacy(300.0, 300.0, 1.0, None)
    assert "noise is that of the fit itself" in sentence("provisional", (), alone, nothing, "")
    assert "repeats do not tell how large the noise is" in sentence("no_gap", (), drifting, nothing, "")
    assert "repeats do not tell" in drifting.sentence("")
    assert "apart from the fit" in alone.sentence("")


def test_what_the_rows_searched_leave_is_no_size_of_what_held_out_rows_refute():
    """Where the rows searched agree, "something is left (0.0 um)" stood before "0.08 mm are left" of the held-out ones."""
    assert Remains(Misfit(0.0, 0.001, 0.005, True), None).words == ""
    assert Remains(Misfit(0.02, 0.03, 0.005, False), None).words == " (20.0 um)"


@pytest.mark.parametrize("name", ["bootstraps", "resamples", "permutations", "max_effects", "next_poses"])
def test_numbers_without_measure_are_refused(name):
    with pytest.raises(OptionError, match=f"{name} is 1000000000: give a number from"):
        GapOptions.from_document({name: 10**9})
    with pytest.raises(OptionError, match=f"{name} is 1.5: give a whole number"):
        GapOptions.from_document({name: 1.5})


def test_held_out_poses_that_lose_by_chance_do_not_outweigh_a_confirmation_that_gains():
    """The reversal error of a real arm was contradicted by a loss of a third of its deviation, and seen again at 1e-5."""
    seen = Replication(("b",), np.ones(1), np.full(1, 0.1), 1e-5, 0.1, guarded=Guarded(9.4e-5, 10.1e-5, False, True))
    evidence = Evidence(0, SimpleNamespace(), (), None, (-0.13, 0.41, 2.4), None, (), 1e-6, 0.1, unseen_poses=12)  # type: ignore[arg-type]
    assert evidence.is_contradicted
    assert not replace(evidence, replication=seen).is_contradicted
    worse = replace(seen, guarded=Guarded(10.1e-5, 9.4e-5, True, False))
    assert replace(evidence, replication=worse, held_out=(1.0, 0.1, 9.0)).is_contradicted
