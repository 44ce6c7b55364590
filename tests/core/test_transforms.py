"""Transforms against scipy and Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from kilter_core.transforms import (
    inverse,
    nearest_rotation,
    pose_from_xyz_rpy,
    right_jacobian_inverse,
    rotation_log,
    skew,
    xyz_rpy_from_pose,
)
from tests.core.truth import some_pose


def test_rpy_is_that_of_urdf_and_comes_back() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        xyz, rpy = rng.normal(size=3), rng.uniform(-1.5, 1.5, 3)
        T = pose_from_xyz_rpy(xyz, rpy)
        np.testing.assert_allclose(T[:3, :3], pin.rpy.rpyToMatrix(*rpy), atol=1e-15)
        for found, given in zip(xyz_rpy_from_pose(T), (xyz, rpy), strict=True):
            np.testing.assert_allclose(found, given, atol=1e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_gimbal_lock_still_gives_the_same_pose(pitch: float) -> None:
    T = pose_from_xyz_rpy(np.zeros(3), np.array([0.4, pitch, -0.3]))
    np.testing.assert_allclose(pose_from_xyz_rpy(*xyz_rpy_from_pose(T)), T, atol=1e-15)


def test_inverse_undoes() -> None:
    T = some_pose(np.random.default_rng(1)).homogeneous
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-15)


def test_nearest_rotation_is_a_rotation_even_from_a_reflection() -> None:
    rng = np.random.default_rng(2)
    R = Rotation.random(rng=rng).as_matrix()
    np.testing.assert_allclose(nearest_rotation(3.0 * R), R, atol=1e-14)
    mirrored = nearest_rotation(R @ np.diag([1.0, 1.0, -0.1]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)
    np.testing.assert_allclose(mirrored, R, atol=1e-14)


def test_logarithm_is_pinocchio_s() -> None:
    R = Rotation.random(30, rng=np.random.default_rng(3)).as_matrix()
    np.testing.assert_allclose(rotation_log(R), [pin.log3(r) for r in R], atol=1e-12)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(4).normal(size=(2, 5, 3))
    np.testing.assert_allclose((skew(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("size", [0.0, 1e-7, 1e-4, 0.3, 2.5, 3.1])
def test_the_derivative_of_the_logarithm_is_pinocchio_s(size: float) -> None:
    axis = np.random.default_rng(5).normal(size=(6, 3))
    w = size * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    expected = [pin.Jlog3(pin.exp3(row)) for row in w]
    np.testing.assert_allclose(right_jacobian_inverse(w), expected, atol=1e-9)
