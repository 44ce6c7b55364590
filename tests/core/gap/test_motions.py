"""Trajectories and link-side encoders: correlated samples, joint-angle residuals."""

from __future__ import annotations

import numpy as np
import pytest

from core.gap import GapOptions, find_gap
from core.gap.trajectory import blocks, correlation_length, is_trajectory, segments
from core.observations import Observations
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


def motion(seed, compliance, samples=1000):
    """Sums of sines in all joints, link encoders behind compliant joints, correlated noise."""
    rng = np.random.default_rng(seed)
    robot = katana()
    t = np.arange(samples) * 4e-3
    speeds = rng.uniform(0.2, 1.1, (3, robot.n_joints))
    phase = rng.uniform(0, 2 * np.pi, (3, robot.n_joints))
    q = sum(0.4 * np.sin(2 * np.pi * f * t[:, None] + p) for f, p in zip(speeds, phase, strict=True))
    qd = np.gradient(q, t, axis=0)
    tau = 3.0 * np.cos(q) + 0.5 * np.sign(qd)
    link = q - compliance * tau + 2e-4 + 2e-5 * red_noise(rng, samples, robot.n_joints, 3.0)
    return robot, Observations(q=q, link_q=link, tau=tau, t=t, direction=np.sign(qd))


def test_link_encoders_show_compliance_by_the_measured_torque():
    robot, rows = motion(0, 1e-4)
    assert is_trajectory(rows)
    report = find_gap(robot, rows, QUICK)
    ids = {j.evidence.candidate.id: j for j in report.effects}
    assert "axial_compliance" in ids
    values = [a.value for a in ids["axial_compliance"].evidence.amplitudes]
    np.testing.assert_allclose(values, 1e-4, rtol=0.1)
    assert "correlated" in {w["code"] for w in report.warnings}


def test_correlated_noise_alone_has_no_name():
    names = [find_gap(*motion(seed, 0.0), QUICK).effects for seed in (1, 2)]
    assert names == [()] * 2


def test_a_new_motion_starts_where_time_does():
    rows = Observations(q=np.zeros((5, 1)), t=np.array([0.0, 1.0, 2.0, 0.0, 1.0]))
    assert segments(rows).tolist() == [0, 0, 0, 1, 1]
