"""Arrays of whichever order, and those that may not be written to, use the kernels that are compiled already."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.kernels import kinematics
from kilter_core.arm.presets import preset_document
from kilter_core.correct.kernels import stream
from kilter_core.correct.program import compile_program
from kilter_core.model import Calibration
from kilter_core.observations import Observations

NOMINAL = Calibration.nominal(robot_from_document(preset_document("katana450-chapter4")))
Q = np.random.default_rng(0).uniform(-0.5, 0.5, (7, 5))


def test_corrected_rows() -> None:
    program = compile_program(NOMINAL)
    expected = program.correct_rows(Q, direction=np.ones(Q.shape)).q
    compiled = list(stream.correct_rows.signatures)
    for order in ("C", "F"):
        kept, signs = np.array(Q, order=order), np.ones(Q.shape, order=order)
        kept.setflags(write=False)
        signs.setflags(write=False)
        assert np.array_equal(program.correct_rows(kept, direction=signs).q, expected)
    assert stream.correct_rows.signatures == compiled


def test_predicted_poses_and_their_derivatives() -> None:
    model, values = NOMINAL.model, NOMINAL.values
    expected, J = model.jacobian(Observations(Q), values)
    assert np.array_equal(model.predict(Observations(Q), values).position, expected.position)
    compiled = [list(kernel.signatures) for kernel in (kinematics.poses, kinematics.screws)]
    for other in (np.asfortranarray(Q), np.repeat(Q, 2, axis=0)[::2]):
        rows = Observations(other)
        assert model.predict(rows, values).position.shape == (7, 3)
        assert model.jacobian(rows, values)[1].shape == J.shape
    assert np.array_equal(model.predict(Observations(np.asfortranarray(Q)), values).position, expected.position)
    assert [list(kernel.signatures) for kernel in (kinematics.poses, kinematics.screws)] == compiled
