"""A robot's default load: in corrections and rows that state none, in conversions, and in what is stored of a robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.conversions import robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.documents.parts import resolved_document, robot_from_resolved
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Payload, Robot
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.effects.compliance import AxialCompliance
from kilter_core.errors import RobotError
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.core.correct.reference import correct

LOAD = {"payload_kg": 4.0, "payload_com_mm": [10.0, -20.0, 90.0]}
STATED = Payload(4.0, (0.01, -0.02, 0.09))


def loaded(**load: object) -> Robot:
    return robot_from_document(preset_document("ur10") | {"load": load or LOAD})


def soft(robot: Robot) -> Calibration:
    model = RobotModel(robot, (AxialCompliance(),))
    values = model.values0()
    values[model.effect_slices()["axial_compliance"]] = 2e-5
    return Calibration(model, values)


def test_a_stream_and_a_trajectory_carry_it_unless_they_state_another() -> None:
    carrying, bare = soft(loaded()), soft(replace(loaded(), load=None))
    stated = CorrectionOptions(payload_kg=STATED.mass, payload_com=STATED.com)
    empty = CorrectionOptions(payload_kg=0.0)
    assert compile_program(carrying).digest == compile_program(bare, stated).digest
    assert compile_program(carrying, empty).digest == compile_program(bare).digest
    assert compile_program(carrying).digest != compile_program(carrying, empty).digest
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    with_load = {"payload_kg": np.full(5, STATED.mass), "payload_com": np.tile(STATED.com, (5, 1))}
    assert np.array_equal(correct(carrying, q).q, correct(bare, q, **with_load).q, equal_nan=True)


def test_robots_without_one_are_stored_as_before_and_with_one_bit_by_bit() -> None:
    bare = replace(loaded(), load=None)
    assert "load" not in resolved_document(bare)
    assert robot_from_resolved("arm", resolved_document(bare)).load is None
    assert robot_from_resolved("arm", resolved_document(loaded())).load == loaded().load


@pytest.mark.parametrize("convention", ["chain", "poe", "mdh"])
def test_other_conventions_keep_it(convention: str) -> None:
    again = robot_from_document(robot_document(loaded(), convention)).load
    assert again is not None
    assert (again.mass, *again.com) == pytest.approx((STATED.mass, *STATED.com))


def test_a_load_without_a_mass_or_with_a_negative_one_is_refused() -> None:
    for load in ({"payload_com_mm": [0, 0, 1]}, {"payload_kg": -1.0}):
        with pytest.raises(RobotError, match=r"load\.payload_kg"):
            loaded(**load)


def test_rows_that_state_a_payload_keep_it() -> None:
    q = np.zeros((2, 6))
    stated = Observations(q, payload_kg=np.array([0.0, 1.0]))
    assert stated.carrying(4.0, STATED.com) is stated
    silent = Observations(q).carrying(4.0, STATED.com)
    assert silent.payload_kg is not None
    assert silent.payload_com is not None
    assert silent.payload_kg.tolist() == [4.0, 4.0]
    assert silent.payload_com[0].tolist() == list(STATED.com)


def test_the_same_pose_under_a_load_elsewhere_is_no_repeat() -> None:
    q = np.zeros((4, 6))
    com = np.zeros((4, 3))
    com[2:, 2] = 0.1
    rows = Observations(q, payload_kg=np.ones(4), payload_com=com)
    assert rows.visits().tolist() == [0, 0, 1, 1]
    apart = [Observations(q, payload_kg=np.ones(4)), rows]
    together = Observations.concatenate(apart)
    assert together.payload_com is not None
    assert together.payload_com[:4].tolist() == np.zeros((4, 3)).tolist()
