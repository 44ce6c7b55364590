"""Genuine rows of arms whose description lacks a rotation or a length are taken; shuffled rows of the same are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.errors import ObservationError
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.model import Calibration
from tests.mix_ups.campaigns import Genuine, fixed_steps, genuine, without_step
from tests.mix_ups.score import of_number, said

CODE = "description_does_not_fit"
ALPHA_1, A_2, D_4 = 2, 3, 6  # fixed steps of the elbow arm below
NAMES = {
    ALPHA_1: "a rotation of 90 degrees about x right after joint 1",
    A_2: "a shift of (773, -2, 1) mm right after joint 2",
    D_4: "a shift of (-5, -777, 1) mm right after joint 3",
}


def warnings_of(g: Genuine, step: int) -> list[dict[str, Any]]:
    """Warnings about the rows of an arm whose table lacks a step."""
    lacking = without_step(g, step)
    return list(refuse_mixed_up(Calibration.nominal(lacking.robot), lacking.rows))


@pytest.mark.parametrize(("step", "name"), NAMES.items())
def test_what_a_table_lacks_is_named(step: int, name: str) -> None:
    """Lengths as Pinocchio's arm has them, which differ from the drawing by some millimetres."""
    g = genuine(5, "6R", see="position")
    (warning,) = warnings_of(g, step)
    assert warning["code"] == CODE
    assert name in warning["message"]


def test_no_step_that_lacks_is_an_accusation() -> None:
    g = genuine(3045, "6R", see="position", worn=True)
    for step in range(len(fixed_steps(g))):
        warnings_of(g, step)


@pytest.mark.parametrize("seed", range(300, 312))
def test_genuine_campaigns_are_not_accused(seed: int) -> None:
    g = of_number(seed)
    assert said(g) == "", g.kind


def test_shuffled_rows_of_such_an_arm_are_refused_unless_a_person_says_that_they_are_right() -> None:
    g = without_step(genuine(5, "6R", see="position"), ALPHA_1)
    begin, rng = Calibration.nominal(g.robot), np.random.default_rng(4)
    rows = replace(g.rows, q=g.rows.q[rng.permutation(len(g.rows))])
    with pytest.raises(ObservationError, match=r"do not belong together.*--unchecked"):
        refuse_mixed_up(begin, rows)
    (warning,) = refuse_mixed_up(begin, replace(rows, unchecked=np.ones(len(rows), dtype=bool)))
    assert warning["code"] == "foreign_observations"
