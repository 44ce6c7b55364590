"""Errors of rows and the uncertainty over the workspace, against arms that share no code with Kilter."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import Folds, Identification, identify
from kilter_core.identify.uncertainty.predictive import POSES, Workspace
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.truth import small_pose, some_pose, ur10, with_hidden_errors

NOISE = 5e-5


@cache
def rows(see: str, count: int, seed: int) -> Observations:
    rng = np.random.default_rng(1)
    true = replace(with_hidden_errors(ur10(), rng), base=some_pose(rng, 3.0), tool=small_pose(rng, 0.05, 0.2))
    rng = np.random.default_rng(seed)
    return measured(true, joints(true, count, rng), rng, NOISE, see)


def found(validation: Observations | float | Folds | None, see: str = "position") -> Identification:
    return identify(robot_from_document(ur10().document()), rows(see, 80, 2), validation)


def rms_mm(errors: dict[str, np.ndarray], stage: str = "identified") -> float:  # type: ignore[type-arg]
    return float(np.sqrt(np.mean(errors[stage] ** 2))) * 1e3


@pytest.mark.parametrize("see", ["position", "pose"])
def test_held_out_rows_are_those_of_the_metrics(see: str) -> None:
    other = rows(see, 30, 3)
    result = found(other, see)
    assert result.held_rows is not None
    assert result.held_rows.rows is not None
    assert result.held_rows.rows.tolist() == list(range(30))
    for stage in ("nominal", "registration_only", "identified"):
        assert rms_mm(result.held_rows.sizes, stage) == pytest.approx(result.metrics["validation"][stage]["rms_mm"])
    assert result.fitted_rows is not None
    assert rms_mm(result.fitted_rows.sizes) == pytest.approx(result.metrics["train"]["identified"]["rms_mm"])


def test_a_fraction_and_folds_number_the_rows_that_were_given() -> None:
    part = found(0.25)
    assert part.held_rows is not None
    assert part.fitted_rows is not None
    held, fitted = part.held_rows.rows, part.fitted_rows.rows
    assert held is not None
    assert fitted is not None
    assert sorted([*held.tolist(), *fitted.tolist()]) == list(range(80))
    assert len(held) == part.metrics["validation"]["n"]
    folds = found(Folds(4)).held_rows
    assert folds is not None
    assert folds.rows is not None
    assert sorted(folds.rows.tolist()) == list(range(80))
    assert found(None).held_rows is None


@pytest.mark.parametrize("see", ["position", "markers"])
def test_place_and_error_are_the_measurement_told_in_the_robot_s_base(see: str) -> None:
    """A rigid move keeps every distance: between the measured points, and of each from the first axis."""
    result = found(rows(see, 30, 3), see)
    errors = result.held_rows
    assert errors is not None
    assert errors.at is not None
    if see == "position":
        told, seen = errors.at + errors.left["identified"], rows(see, 30, 3).position
        assert seen is not None
        apart = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (told, seen)]
        assert np.abs(apart[0] - apart[1]).max() < 1e-12
    drawn, _ = replace(ur10(), tool=small_pose(np.random.default_rng(0), 0.0, 0.0)).poses(rows(see, 30, 3).q)
    assert np.linalg.norm(errors.at - drawn, axis=1).max() < 0.15  # the tool of 0.05 m a side, and some millimetres
    assert np.abs(errors.left["identified"]).max() < 8 * NOISE


def test_the_workspace_is_within_the_limits_and_known_least_where_nobody_measured() -> None:
    train = rows("position", 80, 2)
    near = train.select(np.flatnonzero(np.abs(train.q[:, 0]) < 1.5))
    result = identify(robot_from_document(ur10().document()), near)
    space = Workspace.from_calibration(result.calibration, result.predictive, near, seed=1)
    assert space.points.shape == (POSES, 3)
    assert np.linalg.norm(space.points, axis=1).max() < 1.6
    assert np.linalg.norm(space.measured - ur10().poses(near.q)[0], axis=1).max() < 0.15
    known = result.predictive.of_the_tool(result.calibration, near).max(axis=1)
    assert np.median(space.u95) > np.median(known) > 0.0
    last = space.worst_last()
    assert (np.diff(last.u95) >= 0.0).all()
    again = Workspace.from_calibration(result.calibration, result.predictive, near, seed=1)
    assert np.array_equal(again.points, space.points)
