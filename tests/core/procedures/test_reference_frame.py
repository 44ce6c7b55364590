"""Frames from digitised points, against Pinocchio's poses and scipy's alignment."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_core.errors import ObservationError
from kilter_core.procedures.reference_frame import frame_of_features, frame_of_points
from tests.core.truth import some_pose

KNOWN = np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0.1, 0.1, 0.2]])


def test_known_points_found_again_give_the_frame() -> None:
    rng = np.random.default_rng(0)
    pose = some_pose(rng, 4.0)
    measured = np.array([pose.act(p) for p in KNOWN]) + rng.normal(0, 1e-5, KNOWN.shape)
    found = frame_of_points(KNOWN, measured)
    expected, rms = Rotation.align_vectors(measured - measured.mean(axis=0), KNOWN - KNOWN.mean(axis=0))
    np.testing.assert_allclose(found.pose[:3, :3], expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found.pose, pose.homogeneous, atol=1e-3)
    assert found.rms == pytest.approx(rms / 2.0)  # scipy's is the root of the sum over four points
    flat = frame_of_points(KNOWN[:3], measured[:3])
    np.testing.assert_allclose(flat.pose, pose.homogeneous, atol=1e-3)


def test_a_wrong_point_stands_out() -> None:
    pose = some_pose(np.random.default_rng(1), 4.0)
    measured = np.array([pose.act(p) for p in np.vstack([KNOWN, [0.3, 0.3, 0.1], [0.2, 0, 0.3]])])
    measured[4] += 0.005
    found = frame_of_points(np.vstack([KNOWN, [0.3, 0.3, 0.1], [0.2, 0, 0.3]]), measured)
    assert int(np.argmax(found.left)) == 4


@pytest.mark.parametrize("seed", range(5))
def test_plane_line_and_origin_give_the_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = some_pose(rng, 4.0)
    corners = np.array([[0, 0, 0], [0.5, 0.1, 0], [0.4, 0.6, 0], [-0.1, 0.4, 0.0]])
    line = np.array([[0.1, 0.2, 0.0], [0.3, 0.2, 0.0], [0.6, 0.2, 0.0]])
    found = frame_of_features(
        np.array([pose.act(p) for p in corners]),
        np.array([pose.act(p) for p in line]),
        pose.act(np.array([0, 0, 0.05])),
    )
    np.testing.assert_allclose(found.pose, pose.homogeneous, atol=1e-12)
    assert found.rms < 1e-12


def test_what_makes_no_frame_is_refused() -> None:
    line = np.linspace(0, 1, 4)[:, None] * np.array([[1.0, 2.0, 3.0]])
    cases = [
        (lambda: frame_of_points(line, line), "points_collinear"),
        (lambda: frame_of_points(KNOWN[:2], KNOWN[:2]), "points_collinear"),
        (lambda: frame_of_points(KNOWN, KNOWN * [1, -1, 1]), "points_mirrored"),
        (lambda: frame_of_features(line, KNOWN[:2], KNOWN[0]), "points_collinear"),
        (lambda: frame_of_features(KNOWN[:3], np.array([[0, 0, 0], [0, 0, 1.0]]), KNOWN[0]), "points_collinear"),
    ]
    for make, code in cases:
        with pytest.raises(ObservationError) as refused:
            make()
        assert refused.value.code == code
