"""The tool point first, its orientation second: rows of several arms, held against Pinocchio."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.correct.correction_needs import needs
from kilter_core.correct.kernels.layout import DAMPED, OK, RESIDUAL, SATURATED, TOO_LARGE
from kilter_core.correct.program import CorrectedRows, CorrectionOptions, Track, compile_program
from kilter_core.correct.walker import correct_trajectory
from kilter_core.errors import ObservationError, OptionError
from kilter_core.observations import Observations
from tests.core.correct.twins import ARMS, Twin, twin

TOLD = DAMPED | RESIDUAL | SATURATED


def corrected(arm: Twin, q: np.ndarray, **options: object) -> tuple[CorrectedRows, np.ndarray, np.ndarray]:
    """Rows corrected, how far the real tool is off then (N,), and its angle; what is said to be left is left."""
    rows = compile_program(arm.calibration, CorrectionOptions(**options)).correct_rows(q)  # type: ignore[arg-type]
    left, turned = arm.left(rows.q, q)
    np.testing.assert_allclose(rows.left, left, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(rows.left_rad, turned, rtol=0.0, atol=1e-8)
    return rows, np.linalg.norm(left, axis=1), turned


@pytest.mark.parametrize("name", list(ARMS))
def test_the_point_is_held_within_limits_that_the_version_needs(name: str) -> None:
    for seed in range(2):
        arm = twin(name, seed)
        q = arm.poses(200, seed)
        limits = needs(arm.calibration, arm.poses(300, 99))
        rows, off, _ = corrected(arm, q, largest_rad=limits.largest_rad, farthest_m=limits.farthest_m)
        before, _ = arm.left(q, q)
        assert (rows.status == OK).all()
        assert np.mean(off > 5e-5) <= 0.03
        assert not ((off > 2e-6) & (rows.flags & TOLD == 0)).any()
        assert (off <= np.linalg.norm(before, axis=1) + 1e-9).all()
        assert np.abs(rows.q - q).max() <= limits.largest_rad * (1.0 + 1e-9)


@pytest.mark.parametrize("name", ["ur", "six", "seven"])
def test_the_turn_gives_way_near_a_singular_wrist_and_nowhere_else(name: str) -> None:
    arm = twin(name)
    q = arm.poses(300)
    rows, off, turned = corrected(arm, q, largest_rad=math.radians(3.0))
    assert off.max() < 1e-6
    assert np.median(turned) < 1e-9
    assert not ((turned > 1.1e-4) & (rows.flags & DAMPED == 0)).any()
    pose = compile_program(arm.calibration, CorrectionOptions(task="pose", largest_rad=0.3, farthest_m=0.1))
    clear = turned < 1e-9
    exact = np.linalg.norm(pose.correct_rows(q[clear]).left, axis=1) < 1e-6
    if arm.ideal.n == 6:  # there is one answer then
        np.testing.assert_allclose(rows.q[clear][exact], pose.correct_rows(q[clear]).q[exact], atol=1e-7)


def test_few_joints_turn_the_tool_as_well_as_they_can() -> None:
    arm = twin("scara")
    q = arm.poses(200)
    _, off, turned = corrected(arm, q, largest_rad=0.3, largest_m=0.1, farthest_m=0.1)
    _, before = arm.left(q, q)
    assert np.mean(off < 1e-6) > 0.99  # all but a stretched arm
    assert np.median(turned) < np.median(before)


def test_an_arm_with_joints_to_spare_has_one_answer() -> None:
    arm = twin("seven")
    program = compile_program(arm.calibration, CorrectionOptions())
    t = np.linspace(0.0, 1.0, 400)
    ways = [arm.poses(1, seed) + np.sin(np.pi * t[:, None]) * 0.2 for seed in (3, 4)]
    for way in ways:
        followed = correct_trajectory(arm.calibration, Observations(way, t=4.0 * t))
        np.testing.assert_allclose(followed.q, program.correct_rows(way).q, rtol=0.0, atol=2e-8)


def test_near_a_stretched_elbow_the_exact_correction_is_found_when_the_limits_allow_it() -> None:
    arm = twin("elbow", errors={"a_2": 6e-4, "a_3": 6e-4})
    q = np.column_stack([np.zeros(60), np.full(60, 0.4), np.radians(np.linspace(6.0, 30.0, 60))])
    tight, off, _ = corrected(arm, q)
    assert ((off > 1e-6) == (tight.flags & DAMPED != 0)).all()
    assert (off > 5e-5).any()
    wide, off, _ = corrected(arm, q, largest_rad=math.radians(5.0))
    assert off.max() < 1e-6
    assert np.degrees(np.abs(wide.q - q).max()) > 1.3


@pytest.mark.parametrize(
    ("limits", "bound"), [({"farthest_m": 0.005}, 0.005), ({"largest_rad": 0.008, "farthest_m": 0.05}, 0.008)]
)
def test_at_a_limit_the_correction_is_held_or_refused(limits: dict[str, float], bound: float) -> None:
    arm = twin("ur", errors={"theta_offset_2": 0.012})
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.8, 0.1], (200, 1))
    q[:, 2] = np.linspace(2.2, 0.1, 200)  # stretches the arm
    wide = {"largest_rad": 0.05, "farthest_m": 0.05}
    held, off, _ = corrected(arm, q, **{**wide, **limits})
    before = np.linalg.norm(arm.left(q, q)[0], axis=1)
    at_limit = held.flags & SATURATED != 0
    assert at_limit.any()
    assert (held.status == OK).all()
    assert (off < before).all()
    assert (off[~at_limit] < 1e-6).all()
    if "largest_rad" in limits:
        assert np.abs(held.q - q).max() == pytest.approx(bound)
        assert (held.limit_mask[at_limit] > 0).all()
    else:
        np.testing.assert_allclose(off[at_limit], before[at_limit] - bound, atol=2e-4)
    assert np.abs(np.diff(held.q - q, axis=0)).max() < 1e-3
    refused = compile_program(arm.calibration, CorrectionOptions(at_limit="refuse", **{**wide, **limits})).correct_rows(
        q
    )
    assert ((refused.status == TOO_LARGE) == at_limit).all()


@pytest.mark.parametrize("degrees", [0.2, 1.0, 3.0])
@pytest.mark.parametrize(
    ("name", "task"), [("elbow", "position"), ("six", "pose"), ("ur", "pose"), ("scara", "position")]
)
def test_at_a_limit_no_correction_is_worse_than_none(name: str, task: str, degrees: float) -> None:
    for seed in range(4):
        arm = twin(name, seed)
        q = arm.poses(300, seed + 7)
        if name == "elbow":  # stretched, where the way of a correction bends
            q = np.vstack([q, np.column_stack([np.full((121, 2), 0.4), np.radians(np.linspace(-10.0, 10.0, 121))])])
        _, off, _ = corrected(arm, q, task=task, largest_rad=math.radians(degrees), farthest_m=0.05)
        before, _ = arm.left(q, q)
        assert (off <= np.linalg.norm(before, axis=1) + 1e-9).all()


def test_at_the_limit_of_a_joint_the_whole_correction_is_scaled() -> None:
    arm = twin("ur", errors={"theta_offset_1": -4e-3, "theta_offset_3": 2e-3})
    q = np.tile([0.0, -1.0, 1.2, -0.5, 0.8, 0.1], (50, 1))
    q[:, 0] = np.linspace(2.79, 2.8, 50)
    rows, off, _ = corrected(arm, q, farthest_m=0.05)
    before = np.linalg.norm(arm.left(q, q)[0], axis=1)
    assert (rows.status == OK).all()
    assert (rows.q <= 2.8).all()
    held = rows.flags & SATURATED != 0
    assert held.any()
    assert (rows.limit_mask[held] & 1 == 1).all()
    assert (off <= before * (1.0 + 1e-6)).all()
    assert off[~held].max() < 1e-6
    q[0, 0] = 2.81
    assert correct_trajectory(arm.calibration, Observations(q)).status[0] == 6


def test_what_a_version_needs_is_said() -> None:
    arm = twin("six")
    q = arm.poses(400)
    found = needs(arm.calibration, q)
    widest = CorrectionOptions(largest_rad=math.radians(5.0), largest_m=0.025, farthest_m=0.025)
    size = np.abs(compile_program(arm.calibration, widest).correct_rows(q).q - q)
    assert math.radians(1.0) <= found.largest_rad <= math.radians(5.0)
    assert found.largest_rad == pytest.approx(max(math.radians(1.0), 1.25 * np.quantile(size.max(axis=1), 0.99)))
    np.testing.assert_allclose(found.largest, size.max(axis=0))
    assert found.removed[0.5] == pytest.approx(np.median(np.linalg.norm(arm.left(q, q)[0], axis=1)), rel=1e-6)
    assert found.within_suggested.left <= 0.03
    assert found.within_suggested.left <= found.within.left
    assert found.within.refused == 0.0
    assert not found.capped
    with pytest.raises(ObservationError, match="at least one"):
        needs(arm.calibration, q[:0])


def test_a_zero_offset_that_no_limit_should_take_is_said_to_exceed_them() -> None:
    arm = twin("six", errors={"theta_offset_2": math.radians(2.0)})
    found = needs(arm.calibration, arm.poses(100))
    assert found.capped
    assert found.farthest_m == 0.025
    assert found.within.held > 0.9
    assert found.within_suggested.held > 0.2
    refusing = needs(arm.calibration, arm.poses(100), CorrectionOptions(at_limit="refuse"))
    assert refusing.within.refused == pytest.approx(found.within.held)


@pytest.mark.parametrize("length", [1e9, 1e200, math.nan])
def test_a_version_of_nonsense_gives_no_numbers_that_an_arm_could_follow(length: float) -> None:
    """Held at a limit they would look like a correction; what is not a number compares with no limit at all."""
    arm = twin("ur")
    values = arm.calibration.values.copy()
    values[arm.calibration.names.index("a_2")] = length
    wild = replace(arm.calibration, values=values)
    q = arm.poses(20)
    with np.errstate(all="ignore"):
        program = compile_program(wild)
        assert (program.correct_rows(q).status == TOO_LARGE).all()
        track = Track(program, settled=True)
        assert track.step(np.ascontiguousarray(q[0]), 1, 0.0) == TOO_LARGE
        assert np.isnan(track.out).all()
        assert np.isnan(correct_trajectory(wild, Observations(q)).q).all()


@pytest.mark.parametrize("held", [(0,), (0, 3)])
@pytest.mark.parametrize("name", ["seven", "ur"])
def test_held_joints_stay_and_the_others_hold_the_point(name: str, held: tuple[int, ...]) -> None:
    arm = twin(name)
    q = arm.poses(200)
    rows, off, _ = corrected(arm, q, held_joints=held, largest_rad=math.radians(3.0))
    np.testing.assert_array_equal(rows.q[:, held], q[:, held])
    assert np.mean(off < 1e-6) > 0.9  # elsewhere the other joints cannot, and say so
    assert not ((off > 2e-6) & (rows.flags & TOLD == 0)).any()
    done = correct_trajectory(
        arm.calibration, Observations(q, t=np.arange(200) * 60.0), CorrectionOptions(held_joints=held)
    )
    np.testing.assert_array_equal(done.q[:, held], q[:, held])


def test_joints_that_cannot_be_held_are_refused() -> None:
    arm = twin("ur")
    for held, said in (((6,), "joint 7 is to be held, of 6"), (tuple(range(6)), "every joint is held")):
        with pytest.raises(OptionError, match=said):
            compile_program(arm.calibration, CorrectionOptions(held_joints=held))


def test_options_that_cannot_be_are_refused() -> None:
    with pytest.raises(OptionError, match="at_limit"):
        CorrectionOptions(at_limit="stop")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="change_rad_s2"):
        CorrectionOptions(change_rad_s2=0.0)
