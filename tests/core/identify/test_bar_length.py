"""Ball bars that read another length than the joints command, on arms that share no code with core."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify.bar_length import other_lengths
from kilter_core.observations import Observations
from tests.core.campaigns import held, joints, table_errors
from tests.core.truth import ur10

CENTRE, LENGTH = np.array([0.5, -0.3, 0.3]), 0.3


def rows(flat: bool, arc: float = 2 * np.pi) -> Observations:
    rng, arm = np.random.default_rng(1), ur10()
    turn = np.linspace(0.0, arc, 60)
    rise = np.zeros(60) if flat else rng.uniform(0.1, 1.0, 60)
    ways = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1)
    here, q = np.array([0.2, -1.2, 1.6, -1.9, -1.2, 0.3]), []
    for point in CENTRE + LENGTH * ways:
        here = held(arm, here[None], lambda p, point=point: (p - point, np.eye(3)))[0]
        q.append(here)
    true = arm.moved(table_errors(arm, rng)).poses(np.array(q))[0]
    read = np.linalg.norm(true - CENTRE, axis=1)
    return Observations(np.array(q), bar=np.ones(60, dtype=np.int64), bar_length=read)


@pytest.mark.parametrize("flat", [True, False])
def test_the_length_is_that_of_the_joints(flat: bool) -> None:
    robot, right = robot_from_document(ur10().document()), rows(flat)
    assert right.bar_length is not None
    assert other_lengths(robot, right) == []
    for factor in (1.03, 1000 / 25.4, 0.97):
        wrong = Observations(right.q, bar=right.bar, bar_length=right.bar_length * factor)
        [(bar, read, found)] = other_lengths(robot, wrong)
        assert bar == 1
        assert read == pytest.approx(LENGTH * factor, rel=0.01)
        assert found == pytest.approx(LENGTH, rel=0.005)


def test_a_short_arc_and_other_rows_tell_no_length() -> None:
    robot, short = robot_from_document(ur10().document()), rows(True, 0.3)
    assert short.bar_length is not None
    assert other_lengths(robot, Observations(short.q, bar=short.bar, bar_length=2 * short.bar_length)) == []
    q = joints(ur10(), 20, np.random.default_rng(0))
    assert other_lengths(robot, Observations(q)) == []
    assert other_lengths(robot, Observations(q, bar=np.zeros(20, dtype=np.int64), bar_length=np.ones(20))) == []
