"""Rows before a joint with backlash has moved: nobody knows its side, and the row says what that may cost."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions
from kilter_core.effects.registry import make_effect
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_service.ground import correction_outcome as outcome
from tests.core.truth import ur10

WIDTHS = np.radians([0.0, 0.05, -0.03, 0.0, 0.0, 0.0])


def backlash_version() -> Calibration:
    nominal = Calibration.nominal(robot_from_document(ur10().document()))
    with_effect = nominal.with_effects([make_effect("backlash", joints=[1, 2])])
    values = with_effect.values.copy()
    for joint in (2, 3):
        values[with_effect.names.index(f"backlash_{joint}")] = WIDTHS[joint - 1]
    return replace(with_effect, values=values)


def path(moving: tuple[int, ...], rows: int = 20) -> Observations:
    q = np.tile([0.3, -1.2, 1.4, -0.5, 0.8, 0.1], (rows, 1))
    q[:, list(moving)] += np.linspace(0.0, 0.2, rows)[:, None]
    return Observations(q, t=np.linspace(0.0, 4.0, rows))


def true_errors(wanted: Observations, sent: Any, sides: Any) -> Any:
    """Errors (N,) m of Pinocchio's arm whose joints stand to one side of what they are sent to."""
    there, meant = ur10().poses(sent + 0.5 * WIDTHS * sides)[0], ur10().poses(wanted.q)[0]
    return np.linalg.norm(there - meant, axis=1)


@pytest.mark.parametrize("moving", [(1, 2), (1,), (0,)])
def test_what_the_side_may_cost_is_left_until_the_joint_has_moved(moving: tuple[int, ...]) -> None:
    rows = path(moving)
    found = outcome.correct(backlash_version(), rows, CorrectionOptions(), None)
    known = found.done.direction != 0.0
    assert not known[0].any()
    worst = np.zeros(len(rows.q))
    for second in (-1.0, 1.0):
        for third in (-1.0, 1.0):
            sides = np.where(known, found.done.direction, np.array([0.0, second, third, 0.0, 0.0, 0.0]))
            worst = np.maximum(worst, true_errors(rows, found.done.q, sides))
    assert worst[0] > 2e-4
    settled = known[:, 1] & known[:, 2]
    assert settled.any() == (moving == (1, 2))
    assert np.all(found.remaining_errors >= worst - 2e-6)
    assert np.all(found.remaining_errors[~settled] < 2.0 * worst[~settled])
    assert all(word == outcome.LIMITED for word, good in zip(found.words, settled, strict=True) if not good)
    assert found.words[-1] == (outcome.OK if moving == (1, 2) else outcome.LIMITED)
    (said,) = [line for line in outcome.summary(found) if "From which side" in line]
    assert f"in {int((~settled).sum())} of 20 rows, the first of them row 1" in said


def test_rows_that_state_their_directions_are_corrected_for_them() -> None:
    rows = path((1, 2))
    stated = Observations(rows.q, direction=np.ones_like(rows.q))
    found = outcome.correct(backlash_version(), stated, CorrectionOptions(), None)
    assert set(found.words) == {outcome.OK}
    assert true_errors(stated, found.done.q, np.ones(6)).max() < math.sqrt(3) * 1e-6
