"""Curves of one joint's reading: a magnet off its axis is one name, a local error is one; drawn by hand on plain DH."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.effects import EFFECTS
from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.observations import Observations
from tests.core.gap.time_twins import BASE, DH, NOISE_M, TOOL, robot, tool_points

Floats = NDArray[np.float64]
CURVES = (
    "eccentricity",
    "second_harmonic",
    "encoder_scale",
    "encoder_curve",
    "local_bump",
    "unknown_joint_curve",
    "backlash",
)
QUICK = GapOptions(resamples=10, permutations=5, bootstraps=299, next_poses=0, effects=CURVES)


def rows_with(error: Floats, q: Floats, joint: int, seed: int) -> Observations:
    """Poses of an arm whose joint is off by ``error (N,)`` rad where its reading is ``q``; every fifth was measured twice."""
    rng = np.random.default_rng([seed, 5])
    pose = np.concatenate([np.arange(len(q)), np.arange(0, len(q), 5)])
    dh = DH + rng.normal(size=DH.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    true = q.copy()
    true[:, joint] += error
    points = tool_points(true, dh, np.tile(TOOL, (len(q), 1)))[pose] + BASE
    return Observations(q=q[pose], position=points + NOISE_M * rng.normal(size=points.shape), pose_id=pose)


def poses(count: int, seed: int) -> Floats:
    """Readings (count, 6), each joint over nearly a turn."""
    rng = np.random.default_rng([seed, 4])
    return rng.uniform(-1.0, 1.0, (count, 6)) * np.array([3.1, 1.4, 3.1, 3.1, 2.5, 3.1]) + np.array(
        [0, -1.4, 0, 0, 0, 0]
    )


def magnet(q: Floats, shift: float = 0.12, way: float = 0.7) -> Floats:
    """Error of an angle read from the field of a magnet that is off by ``shift`` of its radius; degrees, and many waves."""
    return np.asarray(np.arctan2(shift * np.sin(q - way), 1.0 + shift * np.cos(q - way)))


def bump(q: Floats, centre: float = 0.9, width: float = 0.2) -> Floats:
    return np.asarray(1.5e-3 * np.exp(-0.5 * ((q - centre) / width) ** 2))


def found_of(report: GapReport) -> list[tuple[str, tuple[int, ...] | None]]:
    return [(j.evidence.candidate.id, j.evidence.candidate.joints) for j in report.effects]


@pytest.mark.parametrize("joint", [2, 3, 5])
def test_a_magnet_off_its_axis_is_one_name(joint: int) -> None:
    """It ended as five names of one joint, most of them at the end of their range."""
    q = poses(110, joint)
    report = find_gap(robot(), rows_with(magnet(q[:, joint]), q, joint, 1), QUICK)
    named = [one for one in found_of(report) if not one[0].startswith("unknown_")]
    assert named == [("encoder_curve", (joint,))]
    assert "at_end_of_range" not in {w["code"] for w in report.warnings}
    assert report.effects[0].claim.physical.id == "joint_curve"
    first = np.degrees([a.value for a in report.effects[0].evidence.amplitudes[:2]])
    assert np.hypot(*first) == pytest.approx(np.degrees(0.12), rel=0.01)  # the first term of the series of arctan
    assert report.gap["after_mm"] < 0.05 * report.gap["before_mm"]


def test_a_local_error_of_a_joint_is_a_bump_at_its_place() -> None:
    q = poses(110, 9)
    report = find_gap(robot(), rows_with(bump(q[:, 2]), q, 2, 2), QUICK)
    assert set(found_of(report)) == {("local_bump", (2,))}
    assert len({j.claim.words for j in report.effects}) == 1
    bumps = [e for j in report.effects for e in j.evidence.candidate.effects if e.id == "local_bump"]
    assert all(abs(e.centre_rad - 0.9) < 0.5 for e in bumps)  # type: ignore[attr-defined]
    assert not report.set_aside


def test_few_poses_carry_no_curve_of_many_waves() -> None:
    tried = {
        count: EFFECTS["encoder_curve"].candidate_configurations(robot(), Observations(q=poses(count, 3)))
        for count in (30, 60, 118)
    }
    assert [len(one) for one in tried.values()] == [0, 6, 8]
