"""Markers: the shape they share and the poses they give, against scipy's align_vectors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from kilter_core.errors import ObservationError
from kilter_core.measurement.markers import fit_poses, marker_shape

Floats = NDArray[np.float64]
TOOL = np.array([[0.03, 0.01, 0.0], [-0.02, 0.04, 0.01], [0.0, -0.05, 0.02], [0.01, 0.0, -0.03]])


def seen(rows: int, markers: int, noise: float, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Rotations, places and noisy markers of a rigid body."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(rows, rng=rng).as_matrix()
    p = rng.uniform(-1.0, 1.0, (rows, 3))
    points = np.einsum("nij,mj->nmi", R, TOOL[:markers]) + p[:, None]
    return R, p, points + rng.normal(0.0, noise, points.shape)


@pytest.mark.parametrize("markers", [3, 4])
def test_poses_are_those_of_scipy(markers: int) -> None:
    _, _, points = seen(30, markers, 1e-4)
    shape = marker_shape(points)
    position, rotation, usable = fit_poses(shape, points)
    assert usable.all()
    for k, row in enumerate(points):
        expected, _ = Rotation.align_vectors(row - row.mean(axis=0), shape - shape.mean(axis=0))
        np.testing.assert_allclose(rotation[k], expected.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(position[k], row.mean(axis=0) - rotation[k] @ shape.mean(axis=0), atol=1e-14)


def test_the_shape_keeps_the_distances_and_stands_in_its_own_frame() -> None:
    _, _, points = seen(5, 4, 0.0)
    shape = marker_shape(points)
    np.testing.assert_allclose(pdist(shape), pdist(TOOL), atol=1e-14)
    np.testing.assert_allclose(shape.mean(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.ptp(shape[:3, 2]), 0.0, atol=1e-15)
    from_middle = shape[0] - shape[:3].mean(axis=0)
    np.testing.assert_allclose(from_middle[1:], 0.0, atol=1e-15)
    assert from_middle[0] > 0.0


def test_the_shape_s_noise_falls_with_the_rows() -> None:
    def wrong(rows: int) -> float:
        found = [pdist(marker_shape(seen(rows, 4, 1e-4, seed)[2])) - pdist(TOOL) for seed in range(20)]
        return float(np.sqrt(np.mean(np.square(found))))

    assert wrong(100) == pytest.approx(wrong(4) / 5.0, rel=0.35)


def test_a_hidden_marker_is_done_without_while_three_are_left() -> None:
    R, _, points = seen(3, 4, 0.0)
    shape = marker_shape(points)
    turn = fit_poses(shape, points)[1][0].T @ R[0]
    points[1, 2] = np.nan
    points[2, :2] = np.nan
    position, rotation, usable = fit_poses(shape, points)
    assert usable.tolist() == [True, True, False]
    np.testing.assert_allclose(rotation[1] @ turn, R[1], atol=1e-12)
    assert np.isnan(position[2]).all()


def test_what_fixes_no_pose_is_refused() -> None:
    _, _, points = seen(4, 4, 0.0)
    with pytest.raises(ObservationError, match="2 markers"):
        marker_shape(points[:, :2])
    with pytest.raises(ObservationError, match="one line") as refused:
        marker_shape(np.linspace(0.0, 1.0, 3)[None, :, None] * np.ones((4, 3, 3)))
    assert refused.value.code == "markers_collinear"
    points[:, 0] = np.nan
    with pytest.raises(ObservationError, match="No row shows marker 1 together with three others"):
        marker_shape(points)
    points[:, 1] = np.nan
    with pytest.raises(ObservationError, match="No row shows three markers"):
        marker_shape(points)


def test_four_markers_of_which_the_first_three_are_in_line_fix_a_pose() -> None:
    body = np.array([[-0.05, 0.0, 0.0], [0.0, 1e-5, 0.0], [0.05, 0.0, 0.0], [0.01, 0.06, 0.0]])
    rng = np.random.default_rng(3)
    R = Rotation.random(20, rng=rng).as_matrix()
    points = np.einsum("nij,mj->nmi", R, body) + rng.uniform(-1, 1, (20, 1, 3)) + rng.normal(0, 2e-5, (20, 4, 3))
    shape = marker_shape(points)
    np.testing.assert_allclose(pdist(shape), pdist(body), atol=5e-5)
    _, rotation, usable = fit_poses(shape, points)
    assert usable.all()
    fixed = rotation[0].T @ R[0]
    angle = np.linalg.norm(Rotation.from_matrix(rotation @ fixed @ R.transpose(0, 2, 1)).as_rotvec(), axis=1)
    assert angle.max() < 5e-3
    # The three in line alone fix none.
    points[4, 3] = np.nan
    assert not fit_poses(shape, points)[2][4]


def test_a_shape_comes_together_from_rows_none_of_which_shows_all() -> None:
    R, p, points = seen(60, 4, 1e-5, seed=2)
    more = np.einsum("nij,j->ni", R, np.array([-0.04, -0.03, 0.02])) + p
    points = np.concatenate([points, more[:, None]], axis=1)
    rng = np.random.default_rng(0)
    for row in points:
        row[rng.choice(5, int(rng.integers(1, 3)), replace=False)] = np.nan
    assert np.isnan(points).any(axis=(1, 2)).all()
    shape = marker_shape(points)
    np.testing.assert_allclose(pdist(shape), pdist(np.vstack([TOOL, [-0.04, -0.03, 0.02]])), atol=2e-5)


def test_a_digitised_point_takes_the_place_of_the_middle() -> None:
    R, p, points = seen(12, 4, 1e-5, seed=5)
    place = np.array([0.0, 0.02, 0.15])
    tip = np.full((12, 3), np.nan)
    tip[3:6] = np.einsum("nij,j->ni", R[3:6], place) + p[3:6]
    shape = marker_shape(points, tip)
    position, _, _ = fit_poses(shape, points)
    np.testing.assert_allclose(position, np.einsum("nij,j->ni", R, place) + p, atol=1e-4)
    points[3:6, :2] = np.nan
    with pytest.raises(ObservationError, match="digitise it while they are seen"):
        marker_shape(points, tip)
    np.testing.assert_array_equal(marker_shape(points[:3], np.full((3, 3), np.nan)), marker_shape(points[:3]))
