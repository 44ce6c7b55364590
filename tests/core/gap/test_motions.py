"""Trajectories and link-side encoders: correlated samples, joint-angle residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.control import by_blocks
from kilter_core.gap.noise.visits import blocks, correlation_length, split_into_windows
from kilter_core.gap.search.linear.settings import tail
from kilter_core.identify.holdout import split
from kilter_core.observations import Observations
from kilter_core.observations.groups import is_trajectory, segments
from tests.core.gap.simulated import katana

EFFECTS = ("backlash", "axial_compliance", "eccentricity", "encoder_scale", "link_bending", "unknown_joint_curve")
QUICK = GapOptions(effects=EFFECTS, resamples=10, permutations=5, bootstraps=499)


def red_noise(rng, rows, columns, length):
    """First-order autoregression with unit variance whose correlation falls by e in ``length`` rows."""
    a = np.exp(-1.0 / length)
    e = rng.standard_normal((rows, columns)) * np.sqrt(1 - a**2)
    for k in range(1, rows):
        e[k] += a * e[k - 1]
    return e


def test_correlation_length_of_an_autoregression():
    e = red_noise(np.random.default_rng(0), 20_000, 3, 10.0)
    assert correlation_length(e) == pytest.approx(20.0, rel=0.15)  # (1 + a) / (1 - a)
    assert correlation_length(np.random.default_rng(1).standard_normal((5000, 3))) < 1.3


def test_blocks_are_ten_correlation_times_and_enough_of_them():
    assert np.bincount(blocks(10_000, 5.0)).max() == 50
    assert blocks(100, 50.0).max() + 1 >= 30


def motion(seed, compliance, samples=1000, lag=0.0, offset=2e-4):
    """Sums of sines in all joints, link encoders behind compliant joints, read late, correlated noise."""
    rng = np.random.default_rng(seed)
    robot = katana()
    t = np.arange(samples) * 4e-3
    speeds = rng.uniform(0.2, 1.1, (3, robot.n_joints))
    phase = rng.uniform(0, 2 * np.pi, (3, robot.n_joints))
    q = sum(0.4 * np.sin(2 * np.pi * f * t[:, None] + p) for f, p in zip(speeds, phase, strict=True))
    qd = np.gradient(q, t, axis=0)
    tau = 3.0 * np.cos(q) + 0.5 * np.sign(qd)
    link = q - compliance * tau - np.asarray(lag) * qd + offset + 2e-5 * red_noise(rng, samples, robot.n_joints, 3.0)
    return robot, Observations(q=q, qd=qd, link_q=link, tau=tau, t=t, direction=np.sign(qd))


def test_link_encoders_show_compliance_by_the_measured_torque():
    robot, rows = motion(0, 1e-4)
    assert is_trajectory(rows)
    report = find_gap(robot, rows, QUICK)
    ids = {j.evidence.candidate.id: j for j in report.effects}
    assert "axial_compliance" in ids
    values = [a.value for a in ids["axial_compliance"].evidence.amplitudes]
    np.testing.assert_allclose(values, 1e-4, rtol=0.1)
    assert "correlated" in {w["code"] for w in report.warnings}


LAGS = replace(QUICK, effects=(*EFFECTS, "tracking_lag", "time_offset"), permutations=20)


def test_an_equal_lag_of_all_joints_is_a_time_offset():
    report = find_gap(*motion(1, 1e-4, lag=1e-3), LAGS)
    said = {j.evidence.candidate.id: j for j in report.effects}
    assert set(said) == {"time_offset", "axial_compliance"}
    assert said["time_offset"].evidence.amplitudes[0].value == pytest.approx(-1e-3, rel=0.02)
    assert all(j.gates["negative_control"] for j in report.effects)


def test_a_lag_of_its_own_per_joint_is_a_tracking_lag():
    report = find_gap(*motion(2, 0.0, lag=[1e-3, 3e-3, 2e-3, 4e-3, 0.5e-3]), LAGS)
    (lag,) = report.effects
    assert lag.evidence.candidate.id == "tracking_lag"
    assert lag.evidence.control.label == "speed"
    assert lag.gates["negative_control"]  # 6 of 20 shuffles kept the name when every sample counted as independent


def test_one_joint_that_lags_more_than_the_others_is_that_joint_beside_an_offset_of_all():
    report = find_gap(*motion(2, 0.0, lag=[1e-3, 1e-3, 1e-3, 2e-3, 1e-3]), LAGS)
    said = {(j.evidence.candidate.id, j.evidence.candidate.joints) for j in report.effects}
    assert said == {("time_offset", None), ("tracking_lag", (3,))}


@pytest.mark.parametrize(("again", "outcome"), [(1.04, "replicated"), (2.5, "other_size"), (-1.0, "contradicted")])
def test_a_delay_is_seen_again_where_something_else_is_left(again, outcome):
    """Of a real arm's delay, 2.9 ms in two motions, deviations beside what is left were so small that 4 % refuted it."""
    (robot, rows), (_, other) = motion(21, 0.0, lag=3e-3), motion(22, 0.0, lag=again * 3e-3)
    for own in (rows, other):
        own.link_q[...] += 1.5e-4 * np.sin(9.0 * own.q)
    report = find_gap(robot, rows, replace(LAGS, effects=("tracking_lag", "time_offset")), confirmation=other)
    (effect,) = (j for j in report.effects if j.evidence.candidate.id in ("tracking_lag", "time_offset"))
    told = effect.evidence.replication
    assert told.apart > 3.0
    assert told.outcome == outcome
    assert effect.verdict == {"other_size": "provisional"}.get(outcome, outcome)
    assert effect.storable is (outcome != "contradicted")


def test_a_curve_that_another_motion_contradicts_shadows_no_effect():
    """It is in one motion only, and compliance may be no part of it: that was provisional for being like it by a third."""
    (robot, rows), (_, other) = motion(37, 1e-4), motion(38, 1e-4)
    q = rows.q[:, 1]
    rows.link_q[:, 1] += 6e-4 * np.sin(3.3 * q + 1.0) * np.exp(-((q / 0.5) ** 2))
    report = find_gap(robot, rows, QUICK, confirmation=other)
    levels = {j.evidence.candidate.id: j.verdict for j in report.effects}
    assert levels["unknown_joint_curve"] == "contradicted"
    assert levels["axial_compliance"] == "replicated"


def chance(shares):
    """Chance of the sum of shares (B, d) of B blocks, as the negative control counts it."""
    return float(tail(*by_blocks(shares, np.ones(len(shares)), np.arange(len(shares)))))


def test_blocks_that_agree_are_no_chance_and_blocks_that_do_not_are():
    rng = np.random.default_rng(0)
    noise = [chance(rng.standard_normal((40, 3))) for _ in range(2000)]
    assert np.mean(np.array(noise) < 0.01) == pytest.approx(0.01, abs=0.008)
    assert chance(rng.standard_normal((40, 3)) + np.array([2.0, 0.0, 0.0])) < 1e-9
    # A few large blocks decide nothing, however many samples they hold.
    assert chance(np.where(np.arange(40) < 2, 50.0, rng.standard_normal(40))[:, None]) > 0.01


def test_where_sees_the_direction_through_a_strong_delay_and_no_joint_without_an_encoder():
    robot, rows = motion(3, 0.0, lag=3e-3)
    rows.link_q[:, 4] = 0.0
    report = find_gap(robot, rows, LAGS)
    sure = {p.factor for p in report.where if p.p_value < 0.01}
    assert {f"direction of joint {j}" for j in (1, 2, 3, 4)} <= sure
    assert not [p.factor for p in report.where if p.factor.endswith("joint 5") or p.factor.startswith("contrast")]


def test_each_held_out_motion_has_encoder_offsets_of_its_own():
    robot, rows = motion(4, 1e-4)
    held = Observations.concatenate([motion(5, 1e-4, offset=2e-3)[1], motion(6, 1e-4, offset=-1e-3)[1]])
    report = find_gap(robot, rows, QUICK, validation=held)
    assert "offsets" in report.gap["held_out"]
    # The noise of 2e-5 rad, and little more: the offsets would be a hundred times that.
    assert report.gap["validation_after_deg"] < np.degrees(2.5e-5)
    assert report.gap["held_out_set_aside"] == 0
    assert all(j.gates["held_out"] for j in report.effects)


def test_the_error_of_joints_is_per_joint():
    robot, rows = motion(7, 1e-4)
    report = find_gap(robot, rows, QUICK, validation=0)
    raw = rows.link_q - rows.q
    assert report.gap["before_deg"] == pytest.approx(np.degrees(np.sqrt(np.mean(np.var(raw, axis=0)))), rel=0.01)


def test_of_a_motion_the_end_is_held_out_and_of_several_whole_ones():
    _, rows = motion(8, 0.0)
    inside, outside = split(rows, 0.25, 0)
    assert inside.max() < outside.min()
    assert len(outside) == 250
    three = Observations.concatenate([rows] * 3)
    inside, outside = split(three, 0.3, 0)
    assert len(outside) == 1000
    assert len(np.unique(segments(three)[outside])) == 1


def test_windows_do_not_span_two_motions():
    rows = Observations(q=np.zeros((7, 1)), t=np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 3.0]))
    assert split_into_windows(rows, 2).window.tolist() == [0, 0, 1, 2, 2, 3, 3]


def test_correlated_noise_alone_has_no_name():
    names = [find_gap(*motion(seed, 0.0), QUICK).effects for seed in (1, 2)]
    assert names == [()] * 2


def test_a_new_motion_starts_where_time_does():
    rows = Observations(q=np.zeros((5, 1)), t=np.array([0.0, 1.0, 2.0, 0.0, 1.0]))
    assert segments(rows).tolist() == [0, 0, 0, 1, 1]
