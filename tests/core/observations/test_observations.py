"""Observations: rows chosen, stacked and grouped into poses."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.errors import ObservationError
from kilter_core.observations import Observations


def rows(count: int = 6, **columns: np.ndarray) -> Observations:
    rng = np.random.default_rng(0)
    return Observations(rng.normal(size=(count, 3)), position=rng.normal(size=(count, 3)), **columns)


def test_selecting_takes_every_column() -> None:
    sigma = np.arange(18.0).reshape(6, 3)
    o = rows(sigma=sigma)
    for index in (np.array([4, 1]), np.array([False, True, False, False, True, False]), slice(1, 5, 3)):
        part = o.select(index)
        assert len(part) == 2
        np.testing.assert_array_equal(part.q, o.q[index])
        np.testing.assert_array_equal(part.sigma, sigma[index])
        assert part.rotation is None


def test_a_column_of_another_length_is_refused_by_name() -> None:
    with pytest.raises(ObservationError, match="payload_kg has 5 rows") as refused:
        rows(payload_kg=np.zeros(5))
    assert refused.value.context["field"] == "payload_kg"


def test_campaigns_stack_in_order() -> None:
    a, b = rows(4), rows(3)
    both = Observations.concatenate([a, b])
    np.testing.assert_array_equal(both.q, np.vstack([a.q, b.q]))
    assert a.position is not None
    assert b.position is not None
    np.testing.assert_array_equal(both.position, np.vstack([a.position, b.position]))


def test_campaigns_with_different_columns_do_not_stack() -> None:
    with pytest.raises(ObservationError, match="payload_kg"):
        Observations.concatenate([rows(), rows(payload_kg=np.zeros(6))])
    with pytest.raises(ObservationError, match="No observations"):
        Observations.concatenate([])


def test_poses_are_told_by_their_id_else_by_their_joints() -> None:
    q = np.array([[0.0, 1.0], [0.5, 1.0], [0.0, 1.0 + 1e-7], [0.0, 1.001]])
    by_joints = Observations(q).pose_groups()
    assert by_joints[0] == by_joints[2]
    assert len(set(by_joints.tolist())) == 3
    by_id = Observations(q, pose_id=np.array([7, 7, 9, 7])).pose_groups()
    assert by_id.tolist() == [0, 0, 1, 0]
