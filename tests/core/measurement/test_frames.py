"""The best base and tool are found wherever the flange moved, also on a sphere; truth is Pinocchio's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.measurement import frames
from kilter_core.measurement.frames import best_frames
from tests.core.truth import some_arm, some_pose, ur10

NOISE_M = 2e-5


@pytest.mark.parametrize("moving", [[0, 1], [1, 2], [3, 4], [4, 5], [3, 4, 5], range(6)])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("random", [False, True])
def test_what_is_left_is_the_noise(moving: list[int], turned: bool, random: bool) -> None:
    rng = np.random.default_rng(len(moving) + 10 * moving[0])
    arm = some_arm(rng, 6) if random else ur10(base=some_pose(rng, 3.0), tool=some_pose(rng, 0.3))
    q = np.tile(rng.uniform(-2, 2, 6), (60, 1))
    q[:, list(moving)] = rng.uniform(-2, 2, (60, len(moving)))
    bare = replace(arm, base=pin.SE3.Identity(), tool=pin.SE3.Identity())
    (f, F), (p, R) = bare.poses(q), arm.poses(q)
    p = p + rng.normal(0.0, NOISE_M, p.shape)
    T, tool = best_frames(f, F, p, np.zeros(3), R if turned else None)
    left = p - (T[:3, 3] + (f + F @ tool) @ T[:3, :3].T)
    assert np.sqrt(np.mean(np.sum(left**2, axis=1))) < 1.3 * np.sqrt(3.0) * NOISE_M
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    if turned and random:
        np.testing.assert_allclose(T[:3, :3], arm.base.rotation, atol=2e-3)


def test_orientation_decides_what_positions_do_not_tell() -> None:
    """One joint moves: positions lie on a circle, and only the orientation says how the flange stands beside it."""
    rng = np.random.default_rng(4)
    arm = ur10(base=some_pose(rng, 3.0), tool=some_pose(rng, 0.3))
    q = np.tile(rng.uniform(-1, 1, 6), (30, 1))
    q[:, [0, 5]] = rng.uniform(-1.5, 1.5, (30, 2))
    bare = replace(arm, base=pin.SE3.Identity(), tool=pin.SE3.Identity())
    (f, F), (p, R) = bare.poses(q), arm.poses(q)
    T, _ = best_frames(f, F, p, arm.tool.translation, R)
    np.testing.assert_allclose(T[:3, :3], arm.base.rotation, atol=1e-5)


@pytest.mark.parametrize("noise_m", [0.0, NOISE_M])
def test_a_walk_that_has_arrived_takes_no_further_steps(noise_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loss there wavers by the last digit: where nothing is left a walk went on for six steps."""
    steps, turned_by = [], frames._rotations
    arm = ur10(base=some_pose(np.random.default_rng(1), 3.0))
    for seed in range(12):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2, 2, (40, 6))
        (f, F), (p, _) = replace(arm, base=pin.SE3.Identity()).poses(q), arm.poses(q)
        p = p + rng.normal(0.0, noise_m, p.shape)
        there = best_frames(f, F, p, np.zeros(3))[0][:3, :3]
        monkeypatch.setattr(frames, "_rotations", lambda w: (steps.append(1), turned_by(w))[1])
        best_frames(f, F, p, np.zeros(3), near=there)
        monkeypatch.undo()
    assert len(steps) <= 36


@pytest.mark.parametrize("rows", [1, 2, 5])
@pytest.mark.parametrize("same", ["points", "poses", "both", "line"])
@pytest.mark.parametrize("turned", [False, True])
def test_rows_that_tell_no_rotation_still_have_a_best_place(rows: int, same: str, turned: bool) -> None:
    """A single row, points that are all one, an arm that stood still, points on a line: no error, and a rotation."""
    rng = np.random.default_rng(rows)
    arm = ur10(base=some_pose(rng, 3.0), tool=some_pose(rng, 0.3))
    q = rng.uniform(-2, 2, (rows, 6))
    if same in ("poses", "both"):
        q[:] = q[0]
    (f, F), (p, R) = replace(arm, base=pin.SE3.Identity(), tool=pin.SE3.Identity()).poses(q), arm.poses(q)
    if same in ("points", "both"):
        p = np.tile(p[0], (rows, 1))
    if same == "line":
        p = p[0] + np.outer(np.arange(rows), [0.1, 0.0, 0.0])
    T, tool = best_frames(f, F, p, np.zeros(3), R if turned else None)
    assert np.isfinite(tool).all()
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    if same == "both":  # nothing moved: base and tool explain it all
        np.testing.assert_allclose(T[:3, 3] + (f + F @ tool) @ T[:3, :3].T, p, atol=1e-6)
