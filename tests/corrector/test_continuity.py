"""No step in the corrected stream: signs, reversals, changes of version, the beginning."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.model import Calibration

DT = 0.002
RATE = math.radians(0.5)
FREE = {"change_rad_s": 1e6, "change_rad_s2": 1e9}
REVERSING, RAMPING = 0x0400, 0x0200


def follow(track: Track, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corrections and flags along a path."""
    steps = np.full(len(q), DT)
    done, out, info, _ = track.follow(np.ascontiguousarray(q), 1, steps)
    assert done == len(q)
    return out - q, info[:, 0].astype(int)


def through_zero_moment(count: int = 4000) -> np.ndarray:
    """Joint 4 swings the hand over the vertical, where the moments about it and about joint 3 change sign."""
    q = np.tile([0.2, 0.9, 0.5, 0.0, 0.3], (count, 1))
    q[:, 3] = np.linspace(-1.7, 1.7, count)
    return q


def test_a_sign_change_is_no_step(calibration_of: Callable[..., Calibration]) -> None:
    calibration = calibration_of("katana450-chapter4", ("backlash_load",))
    hard = compile_program(calibration, CorrectionOptions(least_softening_nm=0.0, rate_rad_s=1e6, **FREE))
    limited = compile_program(calibration, CorrectionOptions(least_softening_nm=0.0))
    jump = np.abs(np.diff(follow(Track(hard, settled=True), through_zero_moment())[0], axis=0)).max()
    delta, flags = follow(Track(limited, settled=True), through_zero_moment())
    steps = np.abs(np.diff(delta, axis=0)).max()
    assert jump > math.radians(0.02)  # without the limit the sign change is a step
    # One joint's play moves at the limit; what the others do for it is of the same size.
    assert steps < 3 * RATE * DT
    assert (flags & REVERSING).any()


def test_tilt_is_limited_too(calibration_of: Callable[..., Calibration]) -> None:
    calibration = calibration_of("katana450-chapter4", ("clearance_tilt",))
    program = compile_program(calibration, CorrectionOptions(least_softening_nm=0.0))
    delta, _ = follow(Track(program, settled=True), through_zero_moment())
    assert np.abs(np.diff(delta, axis=0)).max() < 6 * RATE * DT


def test_a_reversal_is_kept_across_chunks(calibration_of: Callable[..., Calibration]) -> None:
    calibration = calibration_of("katana450-chapter4", ("backlash",))
    program = compile_program(calibration)
    t = np.arange(3000) * DT
    q = np.array([0.1, 0.6, 0.4, 0.3, 0.2]) + 0.05 * np.sin(t)[:, None]
    whole, _ = follow(Track(program, settled=True), q)
    track = Track(program, settled=True)
    parts = np.vstack([follow(track, part)[0] for part in np.array_split(q, 37)])
    assert np.array_equal(whole, parts)
    assert np.abs(np.diff(whole, axis=0)).max() < 3 * RATE * DT
    assert np.ptp(track.state[:-1, 5]) == 0.0  # all joints move together, so they agree on the direction


def test_a_joint_that_trembles_does_not_reverse(calibration_of: Callable[..., Calibration]) -> None:
    calibration = calibration_of("katana450-chapter4", ("backlash",))
    track = Track(compile_program(calibration, CorrectionOptions(reversal_band=1e-4)), settled=True)
    base = np.array([0.1, 0.6, 0.4, 0.3, 0.2])
    follow(track, base + np.linspace(0, 0.01, 50)[:, None])
    follow(track, base + 0.01 + 2e-5 * np.sin(np.arange(50))[:, None])
    assert np.all(track.state[:-1, 5] == 1.0)


def test_a_stream_begins_without_correction_and_ramps_in(katana: Calibration) -> None:
    program = compile_program(katana)
    q = np.tile([0.1, 0.6, 0.4, 0.3, 0.2], (2000, 1))
    delta, flags = follow(Track(program), q)
    settled, _ = follow(Track(program, settled=True), q[:1])
    assert np.allclose(delta[0], 0.0, atol=1e-12)
    assert np.allclose(delta[-1], settled[0], atol=1e-9)
    assert flags[0] & RAMPING
    assert not flags[-1] & RAMPING
    assert np.abs(np.diff(delta, axis=0)).max() < 2 * RATE * DT


def test_a_change_of_version_is_ramped(katana: Calibration, calibration_of: Callable[..., Calibration]) -> None:
    other = compile_program(calibration_of("katana450-chapter4", seed=7))
    track = Track(compile_program(katana), settled=True)
    t = np.arange(2000) * DT
    q = np.array([0.1, 0.6, 0.4, 0.3, 0.2]) + 0.1 * np.sin(t)[:, None]
    before, _ = follow(track, q[:500])
    track.change(other)
    after, flags = follow(track, q[500:])
    joined = np.vstack([before, after])
    natural = np.abs(np.diff(before, axis=0)).max()
    assert np.abs(np.diff(joined, axis=0)).max() < natural + 3 * RATE * DT
    assert flags[0] & RAMPING
    assert not flags[-1] & RAMPING
    direct, _ = follow(Track(other, settled=True), q[500:])
    assert np.allclose(after[-1], direct[-1], atol=1e-9)


def test_a_refused_setpoint_leaves_the_memory_alone(katana: Calibration) -> None:
    track = Track(compile_program(katana), settled=True)
    follow(track, np.tile([0.1, 0.6, 0.4, 0.3, 0.2], (5, 1)))
    before = track.state.copy()
    assert track.step(np.array([0.1, math.nan, 0.4, 0.3, 0.2]), 1, DT) == 5
    assert track.step(np.array([0.1, 9.0, 0.4, 0.3, 0.2]), 1, DT) == 6
    assert track.step(np.array([2.1, 0.6, 0.4, 0.3, 0.2]), 1, DT) == 8
    assert np.array_equal(track.state, before)
    assert np.all(np.isnan(track.out))


@pytest.mark.parametrize(("options", "mask"), [({"largest_rad": 1e-5}, True), ({"farthest_m": 1e-6}, False)])
def test_a_correction_beyond_its_bounds_is_refused(katana: Calibration, options: dict[str, float], mask: bool) -> None:
    track = Track(compile_program(katana, CorrectionOptions(at_limit="refuse", **options)), settled=True)
    assert track.step(np.array([0.1, 0.6, 0.4, 0.3, 0.2]), 1, DT) == 7
    assert (track.info[1] > 0) == mask
