"""Steps are found at their row: the twins are plain DH in numpy and share nothing with the core."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.effects import BASE, make_effect
from kilter_core.effects.laws import carried_effects
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.search.events import (
    Course,
    event_effects,
    event_key,
    place_events,
    replace_events,
    with_row_numbers,
)
from kilter_core.gap.search.linear import settings as derivatives
from kilter_core.gap.search.linear.linearized import linearise_problem
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.blind.generator import cases
from tests.blind.run import run_case
from tests.core.gap.time_twins import BASE as BASE_AT
from tests.core.gap.time_twins import NOISE_M, TOOL, robot, tool_points, twin

QUICK = GapOptions(
    resamples=10, permutations=3, bootstraps=299, next_poses=0,
    effects=("base_step", "tool_step", "zero_step", "drift", "zero_drift", "settling", "random_walk", "backlash"),
)  # fmt: skip


def said(report):
    (warning,) = [w for w in report.warnings if w["code"] == "moved_once"]
    return warning


@pytest.mark.parametrize(("kind", "name", "who"), [
    ("base", "base_step", "The station"), ("tool", "tool_step", "The tool"), ("zero", "zero_step", "The zero of joint"),
])  # fmt: skip
@pytest.mark.parametrize("clock", [True, False])
def test_a_step_is_named_with_its_row(kind, name, who, clock):
    made = twin(kind, 5, clock=clock)
    report = find_gap(robot(), made.rows, QUICK)
    (effect,) = report.effects
    assert effect.evidence.candidate.id == name
    if kind == "zero":
        assert effect.evidence.candidate.joints == (made.joint,)
        assert effect.evidence.amplitudes[0].value == pytest.approx(5e-4, rel=0.1)
    warning = said(report)
    assert abs(warning["row"] - (made.row + 1)) <= 1
    assert warning["message"].startswith(who)
    assert f"between rows {warning['row'] - 1} and {warning['row']}" in warning["message"]


def test_what_is_stored_has_the_state_after_the_step():
    made = twin("base", 5)
    kept = find_gap(robot(), made.rows, QUICK).stored.calibration
    late = made.rows.select(slice(made.row + 2, None))
    left = np.linalg.norm(kept.model.predict(late, kept.values).position - late.position, axis=1)
    assert np.sqrt(np.mean(left**2)) < 8e-5
    other_day = replace(late, t=None)
    again = kept.model.predict(other_day, kept.values).position
    np.testing.assert_allclose(again, kept.model.predict(late, kept.values).position, atol=1e-12)


def another_day(made, seed):
    """Poses of the arm as it is after the step, on a clock of their own that begins at 0."""
    rng = np.random.default_rng([seed, 3])
    q = rng.permutation(made.rows.q) + rng.normal(0.0, 0.1, made.rows.q.shape)
    dq = np.zeros_like(q)
    dq[:, made.joint] = made.zeros[-1, made.joint]
    points = tool_points(q + dq, made.dh, np.tile(TOOL, (len(q), 1))) + BASE_AT
    t = np.linspace(0.0, float(made.rows.t[-1]), len(q))
    seen = points + NOISE_M * rng.normal(size=points.shape)
    return Observations(q=q, position=seen, pose_id=np.arange(len(q)), t=t, temperature_c=np.full(len(q), 21.0))


def test_another_campaign_comes_after_a_step_whatever_its_own_clock_says():
    made = twin("zero", 5)
    rows = another_day(made, 5)
    report = find_gap(robot(), made.rows, QUICK, confirmation=rows)
    (effect,) = report.effects
    again = effect.evidence.replication
    assert again.outcome == "not_testable"
    assert "happened once" in again.reason
    assert effect.verdict in {"confirmed", "class_confirmed"}  # what cannot be seen again contradicts nothing
    assert again.guarded.with_it < again.guarded.without  # the arm has its new zero there
    kept = report.stored.calibration
    right, wrong = (np.linalg.norm(one.predict(rows).position - rows.position, axis=1).mean()
                    for one in (kept.for_another_campaign(rows), kept))  # fmt: skip
    assert right < 0.75 * wrong


def test_held_out_rows_of_another_set_up_are_said_to_be():
    made = twin("zero", 5)
    rows = another_day(made, 5)
    moved = replace(rows, position=rows.position @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [1.0, 2.0, 0.1])
    report = find_gap(robot(), made.rows, QUICK, validation=moved)
    (said,) = [w for w in report.warnings if w["code"] == "set_up_elsewhere"]
    assert said["refitted_mm"] < 0.3 < 100 < said["version_mm"]
    assert "confirmation" in said["message"]


def test_times_that_count_from_1970_are_one_clock():
    rows = Observations(q=np.zeros((2, 6)), t=np.array([1.7e9, 1.7e9 + 60.0]))
    step, drift = make_effect("base_step", at_s=1.7e9 + 30.0), make_effect("drift")
    assert carried_effects((step, drift), rows) == (step, drift)
    own = replace(rows, t=rows.t - 1.7e9)
    after, same = carried_effects((step, drift), own)
    assert (after.at_s, after.at_row, same) == (None, 0, drift)
    local = after.local(RobotModel(robot(), (after,)).batch(replace(own, row=np.array([1, 2]))), np.full(6, 1e-3))
    assert not np.any(local.base)


def test_sessions_are_a_remedy_that_works():
    """Split where the search says, every session with a base of its own: the error falls to that of the noise."""
    from kilter_core.identify import IdentifyOptions, identify

    made = twin("base", 5)
    row = said(find_gap(robot(), made.rows, QUICK))["row"]
    session = (np.arange(len(made.rows)) >= row - 1).astype(np.int64)
    whole = identify(robot(), made.rows).metrics["train"]["identified"]["rms_mm"]
    rows = replace(made.rows, session=session, setup=session)
    split = identify(robot(), rows, options=IdentifyOptions(refit=("base",))).metrics["train"]["identified"]["rms_mm"]
    assert split < 0.08
    assert split < 0.5 * whole


def test_a_clean_campaign_has_no_step():
    for seed in range(3):
        assert not find_gap(robot(), twin("none", seed).rows, QUICK).effects


@pytest.mark.parametrize("resting", [False, True])
def test_a_step_put_elsewhere_is_as_if_all_had_been_linearised_again(monkeypatch, resting):
    monkeypatch.setattr(derivatives, "MOST_BYTES", 0 if resting else 1 << 30)
    made = twin("tool", 5)
    prepared = prepare_data(Calibration.nominal(robot()), with_row_numbers(made.rows), QUICK)
    settings, values = prepared.problem.settings, prepared.problem.values
    early = {event_key(e): replace(e, at_s=float(made.rows.t[8]), at_row=None) for e in event_effects(settings.source)}
    before = linearise_problem(replace(settings, source=replace_events(settings.source, early)), values)
    W, A = before.W_raw.copy(), before.A.copy()
    after, candidates = place_events(before, prepared.library.candidates)
    whole = linearise_problem(after.settings, before.values)
    (step,) = [c for c in candidates if c.id == "tool_step"]
    assert made.rows.t[made.row - 2] < step.effects[0].at_s < made.rows.t[made.row + 1]
    for one, other in ((after.A, whole.A), (after.c, whole.c), (after.W_raw, whole.W_raw), (after.scale, whole.scale)):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())
    assert np.array_equal(before.W_raw, W)
    assert np.array_equal(before.A, A)
    assert not np.allclose(after.A, A)


def test_rows_are_ordered_by_their_clock_else_as_given():
    q = np.zeros((12, 6))
    t = np.arange(12.0)[::-1]
    by_clock = Course.from_observations(with_row_numbers(Observations(q=q, t=t)))
    assert by_clock is not None
    assert by_clock.timed
    assert by_clock.order.tolist() == list(range(12))[::-1]
    by_row = Course.from_observations(with_row_numbers(Observations(q=q)))
    assert by_row is not None
    assert not by_row.timed
    assert by_row.mark(5) == {"at_s": None, "at_row": 6}
    assert Course.from_observations(Observations(q=q)) is None


def test_rows_before_a_step_have_the_old_place_and_unknown_ones_the_new():
    arm = robot()
    rows = Observations(q=np.zeros((4, 6)), t=np.arange(4.0))
    effect = make_effect("base_step", at_s=1.5)
    model = RobotModel(arm, (effect,))
    local = effect.local(model.batch(rows), np.array([1e-3, 0, 0, 0, 0, 0]))
    assert local.base is not None
    assert local.base[:, 0].tolist() == [-1e-3, -1e-3, 0.0, 0.0]
    unknown = effect.local(model.batch(replace(rows, t=None)), np.full(6, 1e-3))
    assert not np.any(unknown.base)
    assert {d.joint for d in unknown.derivatives} == {BASE}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "physical"),
    [("base", "station"), ("tool", "tool"), ("none", None)],
)  # fmt: skip
def test_a_step_is_claimed_within_its_class_at_its_row(kind, physical):
    """Against the whole library: steps at their row, and nothing that takes another class for certain."""
    for seed in range(20, 32):
        made = twin(kind, seed)
        report = find_gap(robot(), made.rows, replace(QUICK, effects=()))
        sure = [j for j in report.effects if j.verdict != "provisional"]
        if physical is None:
            assert not report.effects, seed
            continue
        kept = [j.claim.physical.id for j in sure]
        assert set(kept) <= {physical}, (seed, kept)
        assert abs(said(report)["row"] - (made.row + 1)) <= 1, seed


def test_a_step_beside_a_walk_is_claimed_as_motion_of_the_station():
    """Six straight pieces do not follow all of a walk, and what they leave looked like a step: it was *confirmed*."""
    case = next(case for case in cases(20261129, 600) if case.name == "0144-drifting-elbow-118")
    report = run_case(case)["report"]
    said = {e["id"]: e for e in report["effects"]}
    assert said.keys() == {"random_walk", "base_step"}
    assert said["base_step"]["verdict"] == "class_confirmed"
    assert said["base_step"]["claim"]["words"].startswith("motion with time of base, station, air or arm")
    (warning,) = [w for w in report["warnings"] if w["code"] == "moved_once"]
    assert "may have moved" in warning["message"]
