"""Steps are found at their row: the twins are plain DH in numpy and share nothing with the core."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.effects import BASE, make_effect
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.search.events import Course, numbered
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.gap.time_twins import robot, twin

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


def test_rows_are_ordered_by_their_clock_else_as_given():
    q = np.zeros((12, 6))
    t = np.arange(12.0)[::-1]
    by_clock = Course.of(numbered(Observations(q=q, t=t)))
    assert by_clock is not None
    assert by_clock.timed
    assert by_clock.order.tolist() == list(range(12))[::-1]
    by_row = Course.of(numbered(Observations(q=q)))
    assert by_row is not None
    assert not by_row.timed
    assert by_row.mark(5) == {"at_s": None, "at_row": 6}
    assert Course.of(Observations(q=q)) is None


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
