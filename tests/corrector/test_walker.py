"""Rules of the walker that no single transport shows."""

from __future__ import annotations

import numpy as np

from kilter_core.correct.kernels.layout import LAST_SIGN
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.correct.walker import correct_trajectory, headings
from kilter_core.model import Calibration
from kilter_core.observations import Observations

BAND = CorrectionOptions().reversal_band


def wandering(rows: int = 400, joints: int = 5) -> np.ndarray:
    """Steps about as large as the band, so that many of them turn a joint and many do not."""
    steps = np.random.default_rng(3).normal(size=(rows, joints)) * BAND * [0.02, 0.3, 1.0, 3.0, 100.0]
    return 0.4 + np.cumsum(steps, axis=0)


def test_directions_are_those_of_the_stream(katana: Calibration) -> None:
    q = wandering()
    track, seen = Track(compile_program(katana), settled=True), []
    for row in q:
        assert track.step(row, 1, 0.01) == 0
        seen.append(track.state[:5, LAST_SIGN].copy())
    assert np.array_equal(headings(q, BAND), seen)
    assert 0 < np.count_nonzero(np.diff(np.array(seen), axis=0)) < q.size


def test_rows_with_times_and_without_reckon_with_the_same_directions(katana: Calibration) -> None:
    q, options = wandering(), CorrectionOptions(rate_rad_s=1e6)  # no play is still being crossed
    apart = correct_trajectory(katana, Observations(q), options)
    followed = correct_trajectory(katana, Observations(q, t=np.arange(len(q)) * 1.0), options)
    assert np.array_equal(apart.direction, followed.direction)
    assert np.abs(apart.q - followed.q).max() < 1e-8
    named = correct_trajectory(katana, Observations(q, direction=apart.direction), options)
    assert np.array_equal(named.q, apart.q)
    assert named.direction is apart.direction


def test_a_refused_row_turns_no_joint(katana: Calibration) -> None:
    q = wandering()
    q[100, 0], q[250] = 50.0, np.nan
    t = np.arange(len(q)) * 1.0
    found = correct_trajectory(katana, Observations(q, t=t))
    refused = found.status != 0
    assert refused.sum() == 2
    assert np.isnan(found.q[refused]).all()
    assert np.isnan(found.error_removed[refused]).all()
    without = correct_trajectory(katana, Observations(q[~refused], t=t[~refused]))
    assert np.array_equal(found.q[~refused], without.q)
    assert np.array_equal(found.direction[~refused], without.direction)


def test_rows_apart_are_refused_as_the_first_of_a_stream(katana: Calibration) -> None:
    q = wandering(4)
    q[1, 2], q[3, 0] = 50.0, np.nan
    found = correct_trajectory(katana, Observations(q))
    first = [Track(compile_program(katana), settled=True).step(row, 1, 0.0) for row in q]
    assert found.status.tolist() == first == [0, 6, 0, 5]
