"""Rate and acceleration of the correction along a stream, and what they cost the tool, held against Pinocchio."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.correct.kernels import layout
from kilter_core.correct.kernels.layout import DAMPED, RAMPING, RESIDUAL, SATURATED, SLOWED
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from tests.core.correct.twins import Twin, twin

DT = 0.002
OPTIONS = CorrectionOptions()
RATE, SPURT = OPTIONS.change_rad_s, OPTIONS.change_rad_s2


@dataclass(frozen=True)
class Streamed:
    """Corrections (K, n) of a path, flags, and how far the real tool is off (K,) with its angle."""

    delta: np.ndarray
    flags: np.ndarray
    off: np.ndarray
    turned: np.ndarray

    @property
    def rate(self) -> float:
        return float(np.abs(np.diff(self.delta, axis=0)).max()) / DT

    @property
    def acceleration(self) -> float:
        return float(np.abs(np.diff(self.delta, 2, axis=0)).max()) / DT**2


def streamed(arm: Twin, q: np.ndarray, options: CorrectionOptions = OPTIONS, *, settled: bool = True) -> Streamed:
    """Send a path at 500 Hz; what is said to be left is left, and no cycle that leaves something is unmarked."""
    track = Track(compile_program(arm.calibration, options), settled=settled)
    done, out, info, _ = track.follow(np.ascontiguousarray(q), 1, np.full(len(q), DT))
    assert done == len(q)
    left, turned = arm.left(out, q)
    np.testing.assert_allclose(info[:, layout.LEFT : layout.LEFT + 3], left, rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(info[:, layout.LEFT_TURN], turned, rtol=0.0, atol=1e-7)
    flags, off = info[:, 0].astype(int), np.linalg.norm(left, axis=1)
    assert not ((off > 2e-6) & (flags & (DAMPED | RESIDUAL | SATURATED | SLOWED | RAMPING) == 0)).any()
    if arm.ideal.n >= 6:
        assert not ((turned > 1.1e-4) & (flags & (DAMPED | SATURATED | SLOWED | RAMPING) == 0)).any()
    return Streamed(out - q, flags, off, turned)


def through_the_wrist(speed: float) -> np.ndarray:
    """Joint 5 goes through zero at a speed, rad/s, while the arm moves."""
    t = np.arange(-0.6, 0.6, DT)[:, None]
    return np.array([0.3, -1.0, 1.2, -0.5, 0.0, 0.1]) + np.hstack(
        [0.1 * np.sin(t), 0.1 * np.sin(0.7 * t), 0.0 * t, 0.0 * t, speed * t, 0.2 * t]
    )


@pytest.mark.parametrize("name", ["ur", "six"])
@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_a_path_through_the_wrist_keeps_its_point(name: str, speed: float) -> None:
    for seed in range(3):
        found = streamed(twin(name, seed), through_the_wrist(speed))
        assert found.off.max() < 5e-5
        assert found.rate <= RATE * (1.0 + 1e-9)
        assert found.acceleration <= SPURT * (1.0 + 1e-6)


def test_what_changes_too_fast_gives_up_the_turn_and_not_the_point() -> None:
    arm = twin("six", 1)
    slow = CorrectionOptions(change_rad_s=math.radians(0.5), change_rad_s2=math.radians(20.0))
    q = through_the_wrist(1.0)
    q = np.vstack([q, np.tile(q[-1], (500, 1))])
    free, held = streamed(arm, q), streamed(arm, q, slow)
    assert free.rate > 2.0 * slow.change_rad_s
    assert held.rate <= slow.change_rad_s * (1.0 + 1e-9)
    assert held.acceleration <= slow.change_rad_s2 * (1.0 + 1e-6)
    assert held.off.max() < 5e-5
    assert held.turned.max() > free.turned.max()
    assert (held.flags & SLOWED).any()
    assert not held.flags[-1] & SLOWED  # it has caught up
    np.testing.assert_allclose(held.delta[-1], free.delta[-1], atol=1e-9)


def circle(arm: Twin, start: np.ndarray, radius: float = 0.1, count: int = 1000) -> np.ndarray:
    """Joints (K, n) that take the ideal tool round a circle in 2 s without turning it."""
    (p,), (R,) = arm.ideal.poses(start[None])
    q, out = start.copy(), []
    for phase in np.linspace(0.0, 2.0 * math.pi, count):
        aim = p + radius * np.array([math.cos(phase) - 1.0, math.sin(phase), 0.0])
        for _ in range(30):
            (here,), (turn,) = arm.ideal.poses(q[None])
            miss = np.concatenate([aim - here, pin.log3(R @ turn.T)])
            if np.linalg.norm(miss) < 1e-9:
                break
            q = q + np.linalg.solve(arm.ideal.joint_jacobians(q[None])[0], miss)
        out.append(q.copy())
    return np.array(out)


@pytest.mark.parametrize(("wrist", "seed"), [(0.15, 0), (0.3, 1)])
def test_a_circle_near_the_wrist_keeps_its_point(wrist: float, seed: int) -> None:
    arm = twin("ur", seed)
    found = streamed(arm, circle(arm, np.array([0.3, -1.0, 1.2, -0.5, wrist, 0.1])))
    assert found.off.max() < 5e-5
    assert found.rate <= RATE * (1.0 + 1e-9)
    assert found.acceleration <= SPURT * (1.0 + 1e-6)


@pytest.mark.parametrize("degrees", [1.0, 3.0])
@pytest.mark.parametrize(("name", "stretched"), [("ur", 0.0), ("six", math.atan2(0.12, 0.62) - math.pi / 2.0)])
def test_a_path_past_a_stretched_elbow_keeps_its_point(name: str, stretched: float, degrees: float) -> None:
    arm = twin(name)
    q = np.tile([0.3, -1.0, 0.0, -0.5, 0.8, 0.1], (1500, 1))
    q[:, 2] = stretched + np.linspace(-0.4, 0.4, 1500)
    found = streamed(arm, q, CorrectionOptions(largest_rad=math.radians(degrees)))
    assert found.off.max() < 5e-5
    assert found.rate <= RATE * (1.0 + 1e-9)


def test_an_arm_that_only_has_an_elbow_is_not_made_worse_at_its_stretch() -> None:
    arm = twin("elbow")
    q = np.tile([0.3, -1.0, 0.0], (1500, 1))
    q[:, 2] = np.linspace(-0.4, 0.4, 1500)
    found = streamed(arm, q)
    before = np.linalg.norm(arm.left(q, q)[0], axis=1)
    assert (found.off <= 1.05 * before).all()
    assert found.rate <= RATE * (1.0 + 1e-9)


def test_a_path_past_a_limit_goes_on_without_a_jump() -> None:
    arm = twin("ur", errors={"theta_offset_2": 0.012})
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.8, 0.1], (2000, 1))
    q[:, 2] = 1.2 + np.cos(np.linspace(0.0, 2.0 * math.pi, 2000))  # stretches the arm and folds it again
    found = streamed(arm, q, CorrectionOptions(largest_rad=0.05, farthest_m=0.009))
    at_limit = found.flags & SATURATED != 0
    assert at_limit.any()
    assert not at_limit.all()
    assert found.off[~at_limit].max() < 5e-5
    assert found.rate <= RATE * (1.0 + 1e-9)
    assert found.acceleration <= SPURT * (1.0 + 1e-6)


@pytest.mark.parametrize(("name", "degrees", "cycles"), [
    ("ur", 0.1, 2000), ("ur", 0.1, 800), ("ur", 0.3, 800), ("elbow", 0.1, 800), ("elbow", 0.02, 800), ("scara", 0.1, 800),
])  # fmt: skip
def test_at_the_limit_of_its_size_a_correction_arrives_at_rest(name: str, degrees: float, cycles: int) -> None:
    arm = twin(name, 1)
    n = arm.ideal.n
    phases = np.random.default_rng(3).uniform(0.0, 6.0, n)
    t = np.linspace(0.0, 2.0 * math.pi, cycles)[:, None]
    q = 0.5 * arm.ideal.limits[1] * np.sin(t * np.arange(1, n + 1) / n + phases)
    found = streamed(arm, q, CorrectionOptions(largest_rad=math.radians(degrees), largest_m=0.001))
    assert (found.flags & SATURATED).any()
    assert np.abs(found.delta).max() <= math.radians(degrees) * (1.0 + 1e-9) or name == "scara"
    assert found.rate <= RATE * (1.0 + 1e-9)
    assert found.acceleration <= SPURT * (1.0 + 1e-6)
    assert (found.off <= np.linalg.norm(arm.left(q, q)[0], axis=1) + 1e-9).all()


@pytest.mark.parametrize("period_s", [0.0002, 0.0005])
def test_a_stream_above_a_kilohertz_keeps_to_the_same_rate(period_s: float) -> None:
    arm = twin("six", 1)
    slow = CorrectionOptions(change_rad_s=math.radians(0.5), change_rad_s2=math.radians(20.0))
    t = np.arange(-0.4, 0.4, period_s)[:, None]
    q = np.array([0.3, -1.0, 1.2, -0.5, 0.0, 0.1]) + np.hstack(
        [0.1 * np.sin(t), 0.1 * np.sin(0.7 * t), 0.0 * t, 0.0 * t, t, 0.2 * t]
    )
    track = Track(compile_program(arm.calibration, slow), settled=True)
    done, out, info, _ = track.follow(q, 1, np.full(len(q), period_s))
    assert done == len(q)
    assert (info[:, 0].astype(int) & SLOWED).any()
    delta = out - q
    assert np.abs(np.diff(delta, axis=0)).max() <= slow.change_rad_s * period_s * (1.0 + 1e-6)
    assert np.abs(np.diff(delta, 2, axis=0)).max() <= slow.change_rad_s2 * period_s**2 * (1.0 + 1e-4)


def test_a_beginning_is_eased_in() -> None:
    arm = twin("ur")
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.8, 0.1], (1500, 1))
    found = streamed(arm, q, settled=False)
    assert np.abs(found.delta[0]).max() < 1e-12
    assert found.off[-1] < 1e-6
    assert found.rate <= OPTIONS.rate_rad_s
    assert found.acceleration < 0.1 * SPURT
    assert not found.flags[-1] & RAMPING


def test_setpoints_of_one_time_do_not_divide_by_it() -> None:
    arm = twin("ur")
    q = through_the_wrist(1.0)[:20]
    track = Track(compile_program(arm.calibration, OPTIONS), settled=True)
    done, out, _, _ = track.follow(q, 1, np.tile([0.0, DT], 10))
    assert done == 20
    assert np.isfinite(out).all()
    assert np.linalg.norm(arm.left(out, q)[0], axis=1).max() < 5e-5
