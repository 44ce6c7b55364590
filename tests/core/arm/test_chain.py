"""Poses and exact Jacobians of any chain against Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import RobotError
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.truth import Arm, some_arm

KINDS = {
    "revolute": {},
    "prismatic": {"prismatic": True},
    "coupled": {"coupled": True},
    "both": {"prismatic": True, "coupled": True},
}
ARMS = [
    pytest.param(kind, n, seed, id=f"{kind}-{n}-{seed}")
    for kind in KINDS
    for n, seed in ((2, 0), (5, 1), (6, 2), (7, 3))
]


def arm_and_rows(kind: str, n: int, seed: int) -> tuple[Arm, np.ndarray]:
    rng = np.random.default_rng(seed)
    return some_arm(rng, n, **KINDS[kind]), rng.uniform(-2.0, 2.0, (12, n))


def model_of(arm: Arm) -> RobotModel:
    return RobotModel(robot_from_document(arm.document()))


@pytest.mark.parametrize(("kind", "n", "seed"), ARMS)
def test_poses_equal_pinocchio(kind: str, n: int, seed: int) -> None:
    arm, q = arm_and_rows(kind, n, seed)
    model = model_of(arm)
    prediction = model.predict(Observations(q), model.values0())
    position, rotation = arm.poses(q)
    np.testing.assert_allclose(prediction.position, position, atol=1e-12, rtol=0)
    np.testing.assert_allclose(prediction.rotation, rotation, atol=1e-12, rtol=0)


@pytest.mark.parametrize(("kind", "n", "seed"), ARMS)
def test_joint_jacobian_equals_pinocchio(kind: str, n: int, seed: int) -> None:
    arm, q = arm_and_rows(kind, n, seed)
    model = model_of(arm)
    prediction, J = model.joint_jacobian(Observations(q), model.values0())
    np.testing.assert_allclose(J, arm.joint_jacobians(q), atol=1e-12, rtol=0)
    np.testing.assert_allclose(prediction.position, arm.poses(q)[0], atol=1e-12, rtol=0)


@pytest.mark.parametrize(("kind", "n", "seed"), ARMS)
def test_every_parameter_column_equals_differences_of_perturbed_pinocchio_models(kind: str, n: int, seed: int) -> None:
    arm, q = arm_and_rows(kind, n, seed)
    model, q = model_of(arm), q[:4]
    _, J = model.jacobian(Observations(q), model.values0())
    named = [s.name for s in arm.steps if s.name in model.names]
    assert set(named) == {s.name for s in arm.steps}
    for name in named:
        column = J[:, :, model.names.index(name)]
        np.testing.assert_allclose(column, arm.parameter_jacobian(q, name), atol=1e-10, rtol=0, err_msg=name)


def test_values_away_from_nominal_are_those_of_the_perturbed_pinocchio_model() -> None:
    arm, q = arm_and_rows("both", 6, 7)
    rng = np.random.default_rng(8)
    errors = {s.name: rng.normal(0.0, 0.1) for s in arm.steps}
    model = model_of(arm)
    values = model.values0() + np.array([errors.get(name, 0.0) for name in model.names])
    prediction, J = model.jacobian(Observations(q), values)
    moved = arm.moved(errors)
    np.testing.assert_allclose(prediction.position, moved.poses(q)[0], atol=1e-12, rtol=0)
    column = J[:, :, model.names.index("p0")]
    np.testing.assert_allclose(column, moved.parameter_jacobian(q, "p0"), atol=1e-10, rtol=0)


def test_a_selection_of_columns_is_a_selection_of_the_whole_jacobian() -> None:
    arm, q = arm_and_rows("both", 6, 9)
    model = model_of(arm)
    free = np.array([1, 4, 8, 13, len(model.names) - 1])
    _, whole = model.jacobian(Observations(q), model.values0())
    _, part = model.jacobian(Observations(q), model.values0(), free)
    np.testing.assert_array_equal(part, whole[:, :, free])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(1, 8), slides=st.booleans(), coupled=st.booleans())
def test_any_arm_has_pinocchio_s_poses_and_jacobian(seed: int, n: int, slides: bool, coupled: bool) -> None:
    rng = np.random.default_rng(seed)
    arm = some_arm(rng, n, prismatic=slides, coupled=coupled)
    model, q = model_of(arm), rng.uniform(-2.0, 2.0, (5, n))
    prediction, J = model.joint_jacobian(Observations(q), model.values0())
    position, rotation = arm.poses(q)
    np.testing.assert_allclose(prediction.position, position, atol=1e-12, rtol=0)
    np.testing.assert_allclose(prediction.rotation, rotation, atol=1e-12, rtol=0)
    np.testing.assert_allclose(J, arm.joint_jacobians(q), atol=1e-12, rtol=0)


def test_no_rows_give_no_poses() -> None:
    arm, _ = arm_and_rows("revolute", 6, 0)
    model = model_of(arm)
    prediction, J = model.jacobian(Observations(np.zeros((0, 6))), model.values0())
    assert prediction.position.shape == (0, 3)
    assert J.shape == (0, 6, len(model.names))


def test_a_joint_that_drives_nothing_is_refused_by_number() -> None:
    document = some_arm(np.random.default_rng(0), 3).document()
    document["joints"].append({"name": "j4"})
    with pytest.raises(RobotError, match="joint 4"):
        robot_from_document(document)
