"""The likelihoods of smooth errors are those of the dense matrices, whatever shape these have."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.identify.uncertainty.structure import SMALL, _Kernel, _without_pose


@pytest.mark.parametrize(("rows", "columns"), [(60, 90), (90, 20), (1, 3), (5, 1), (2, 2)])
def test_likelihoods_are_those_of_dense_matrices(rows: int, columns: int) -> None:
    draw = np.random.default_rng(rows)
    C, y, freedom = draw.normal(size=(rows, columns)), draw.normal(size=rows), rows
    ratios = np.array([1e-4, 0.02, 1.0, 30.0])
    found = _Kernel.of_columns(C, y).log_likelihoods(y, freedom, ratios)
    for ratio, value in zip(ratios, found, strict=True):
        B = np.eye(rows) + ratio * C @ C.T
        rest = y @ np.linalg.solve(B, y) / (y @ y)
        assert value == pytest.approx(-0.5 * (np.linalg.slogdet(B)[1] + freedom * np.log(rest)), abs=1e-4)


@pytest.mark.parametrize("poses", [9, 60])
def test_products_of_levers_and_shapes_are_the_kernel_of_their_columns(poses: int) -> None:
    draw = np.random.default_rng(poses)
    of_pose = np.repeat(np.arange(poses), 3)
    levers, shapes = draw.normal(size=(len(of_pose), 4)), draw.normal(size=(poses, 11))
    basis = np.linalg.qr(draw.normal(size=(len(of_pose), 5)))[0]
    left = draw.normal(size=len(of_pose))
    found = _Kernel.of_shapes(levers, shapes, of_pose, basis, left)
    columns = np.stack([levers[:, i] * shapes[of_pose, k] for i in range(4) for k in range(11)], axis=1)
    columns -= basis @ (basis.T @ columns)
    wide = columns.shape[1] > columns.shape[0]
    np.testing.assert_allclose(found.of_rows, np.sum(columns**2, axis=1), atol=SMALL)
    np.testing.assert_allclose(found.gram, columns @ columns.T if wide else columns.T @ columns, atol=SMALL)
    np.testing.assert_allclose(found.start, left if wide else columns.T @ left, atol=SMALL)


def test_residuals_without_their_pose_are_those_of_a_fit_without_it() -> None:
    draw = np.random.default_rng(4)
    pose = np.repeat(np.arange(12), draw.integers(1, 5, 12))
    J, r = draw.normal(size=(len(pose), 5)), draw.normal(size=len(pose))
    basis = np.linalg.qr(J)[0]
    left = r - basis @ (basis.T @ r)
    found = _without_pose(basis, left, pose)
    for one in np.unique(pose):
        here = pose == one
        without = r[here] - J[here] @ np.linalg.lstsq(J[~here], r[~here])[0]
        scale = np.sqrt(1.0 - np.sum(basis[here] ** 2, axis=1))
        np.testing.assert_allclose(found[here], without * scale, atol=1e-10)
