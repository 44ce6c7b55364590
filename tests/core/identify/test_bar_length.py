"""Ball bars that read another length than the joints command, on arms that share no code with core."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.scale_gauge import explains_better, other_lengths, scale_bar_readings
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import held, joints, table_errors
from tests.core.truth import ur10

CENTRE, LENGTH = np.array([0.5, -0.3, 0.3]), 0.3


def rows(flat: bool, arc: float = 2 * np.pi, seed: int = 1, offset: float = 0.0) -> Observations:
    rng, arm = np.random.default_rng(seed), ur10()
    turn = np.linspace(0.0, arc, 60)
    rise = np.zeros(60) if flat else rng.uniform(0.1, 1.0, 60)
    ways = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1)
    here, q = np.array([0.2, -1.2, 1.6, -1.9, -1.2, 0.3]), []
    for point in CENTRE + LENGTH * ways:
        here = held(arm, here[None], lambda p, point=point: (p - point, np.eye(3)))[0]
        q.append(here)
    zeros = {s.name: offset * rng.normal() for s in arm.steps if s.name and s.joint is not None}
    true = arm.moved(table_errors(arm, rng) | zeros).poses(np.array(q))[0]
    read = np.linalg.norm(true - CENTRE, axis=1)
    return Observations(np.array(q), bar=np.ones(60, dtype=np.int64), bar_length=read)


@pytest.mark.parametrize("flat", [True, False])
def test_the_length_is_that_of_the_joints(flat: bool) -> None:
    arm, right = Calibration.nominal(robot_from_document(ur10().document())), rows(flat)
    assert right.bar_length is not None
    assert other_lengths(arm, right) == []
    for factor in (1.03, 1000 / 25.4, 0.97):
        wrong = Observations(right.q, bar=right.bar, bar_length=right.bar_length * factor)
        [(bar, read, found)] = other_lengths(arm, wrong)
        assert bar == 1
        assert read == pytest.approx(LENGTH * factor, rel=0.01)
        assert found == pytest.approx(LENGTH, rel=0.005)


def test_a_short_arc_and_other_rows_tell_no_length() -> None:
    arm, short = Calibration.nominal(robot_from_document(ur10().document())), rows(True, 0.3)
    assert short.bar_length is not None
    assert other_lengths(arm, Observations(short.q, bar=short.bar, bar_length=2 * short.bar_length)) == []
    q = joints(ur10(), 20, np.random.default_rng(0))
    assert other_lengths(arm, Observations(q)) == []
    assert other_lengths(arm, Observations(q, bar=np.zeros(20, dtype=np.int64), bar_length=np.ones(20))) == []


@pytest.mark.parametrize("seed", range(3))
def test_a_right_bar_beside_an_arm_mastered_wrong_is_not_doubted(seed: int) -> None:
    """Zeros wrong by degrees put the nominal arm's sphere off by more than the limit; the fit knows which is wrong."""
    robot, asked = robot_from_document(ur10().document()), IdentifyOptions(level=1)
    right = rows(False, seed=seed, offset=0.05)
    nominal = Calibration.nominal(robot)
    fit = identify(robot, right, None, asked).fit
    for _, read, found in other_lengths(nominal, right):
        other = scale_bar_readings(right, 1, found / read)
        assert not explains_better(identify(robot, other, None, asked).fit, fit)
    wrong = scale_bar_readings(right, 1, 1.08)
    [(_, read, found)] = other_lengths(nominal, wrong)
    again = identify(robot, scale_bar_readings(wrong, 1, found / read), None, asked).fit
    assert explains_better(again, identify(robot, wrong, None, asked).fit)


@pytest.mark.parametrize("seed", [21, 22, 25])
def test_a_right_bar_in_one_plane_that_tells_the_arm_too_little_is_not_doubted(seed: int) -> None:
    """With zeros wrong by degrees neither length has a fit that comes near such rows, and one that fails says no length."""
    robot, asked = robot_from_document(ur10().document()), IdentifyOptions(level=1)
    right = rows(True, seed=seed, offset=0.05)
    [(_, read, found)] = other_lengths(Calibration.nominal(robot), right)
    fit = identify(robot, right, None, asked).fit
    assert not explains_better(identify(robot, scale_bar_readings(right, 1, found / read), None, asked).fit, fit)
