"""What is left of the tool's error where backlash changes sides: Pinocchio has the loads, and its arm jumps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.kernels import layout
from kilter_core.correct.kernels.layout import OK, REVERSING
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel
from tests.core.soft_arm import scene
from tests.core.truth import Arm

PLAY = np.radians([0.0, 0.03, 0.04, 0.05, 0.02, 0.0])  # from the middle to each side
DT = 0.002
TOLD_M = 3e-7  # less than this of a sign that is softened is not looked at again


@dataclass(frozen=True)
class Loose:
    """An arm whose gears rest on one flank or the other, by the sign of the load about each joint."""

    drawn: Arm

    def left(self, sent: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """What is left of the tool's error (N, 3) m."""
        loads = -np.array([self.drawn.reactions(q, payload=(0.0, np.zeros(3)))[0] for q in sent])
        return np.asarray(self.drawn.poses(sent + PLAY * np.sign(loads))[0] - self.drawn.poses(wanted)[0])

    @property
    def calibration(self) -> Calibration:
        model = RobotModel(robot_from_document(self.drawn.document()), (make_effect("backlash_load"),))
        values = dict(zip((f"backlash_load_{j + 1}" for j in range(6)), PLAY, strict=True))
        return Calibration(model, model.values0() + [values.get(name, 0.0) for name in model.names])


@pytest.fixture(scope="module")
def arm() -> Loose:
    return Loose(scene(poses=2, again=0).drawn)


def test_a_row_near_a_change_of_sides_says_what_it_leaves(arm: Loose) -> None:
    q = np.random.default_rng(4).uniform(-2.5, 2.5, (400, 6))
    found = compile_program(arm.calibration, CorrectionOptions()).correct_rows(q)
    left = arm.left(found.q, q)
    off = np.linalg.norm(left, axis=1)
    assert (found.status == OK).all()
    # Where the load all but vanishes rounding says which flank it is.
    np.testing.assert_allclose(found.left, left, rtol=0.0, atol=TOLD_M)
    assert not ((off > 2e-6) & (found.flags & REVERSING == 0)).any()
    assert 0 < np.mean(off > 5e-5) < 0.05  # softness follows the load of each joint: few rows are near a change


def test_a_stream_says_what_it_leaves_while_a_joint_crosses_its_backlash(arm: Loose) -> None:
    t = np.arange(0.0, 4.0, DT)[:, None]
    q = np.array([0.3, -1.4, 0.4, -0.6, 1.2, 0.2]) + np.hstack([0.2 * t, 0.5 * np.sin(2.0 * t), *[0.4 * np.sin(t)] * 4])
    track = Track(compile_program(arm.calibration, CorrectionOptions()), settled=True)
    done, out, info, _ = track.follow(np.ascontiguousarray(q), 1, np.full(len(q), DT))
    assert done == len(q)
    left = arm.left(out, q)
    off, flags = np.linalg.norm(left, axis=1), info[:, 0].astype(int)
    np.testing.assert_allclose(info[:, layout.LEFT : layout.LEFT + 3], left, rtol=0.0, atol=TOLD_M)
    crossing = off > 5e-5
    assert 20 < crossing.sum() < 0.5 * len(q)
    assert (flags[crossing] & REVERSING != 0).all()
    assert off.max() > 2e-4
    assert (np.abs(np.diff(out - q, axis=0)) <= math.radians(5.0) * DT * (1.0 + 1e-9)).all()
