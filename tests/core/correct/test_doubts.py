"""Where a version is unsure its answers have a flag: rows, streams, and programs that were written as a file."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct import file
from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram, Track, compile_program
from kilter_core.model import Calibration
from kilter_core.model.calibration import Doubt, unexplained_error

ROBOT = robot_from_document({"name": "arm", "convention": "preset", "preset": "ur10"})


def version_with(*doubts: Doubt) -> Calibration:
    """A version that moves its zeros by a tenth of a milliradian, read back from its document."""
    nominal = Calibration.nominal(ROBOT)
    values = nominal.values + 1e-4
    stored = Calibration(nominal.model, values, doubts=doubts).to_document()
    return Calibration.from_document(ROBOT, stored)


def along(joint: int, low: float, high: float) -> Doubt:
    box = Doubt.everywhere(ROBOT.n_joints, 3e-4, "near")
    box.low[joint], box.high[joint] = low, high
    return box


@pytest.fixture(scope="module")
def path() -> np.ndarray:
    swing = np.sin(np.linspace(0.0, 5.0, 400))[:, None] * np.array([0.5, 0.4, -0.6, 0.3, 0.5, 0.2])
    return np.ascontiguousarray(swing + np.array([0.1, -1.0, 1.2, 0.2, 0.7, 0.1]))


def flags_along(program: CorrectionProgram, path: np.ndarray) -> np.ndarray:
    done, _, info, _ = Track(program, settled=True).follow(path, 1, np.full(len(path), 0.05))
    assert done == len(path)
    return info[:, 0].astype(int) & layout.UNSURE != 0


def test_rows_and_streams_in_a_box_are_flagged_and_no_others(path: np.ndarray) -> None:
    version = version_with(along(2, 1.0, 1.2), along(0, 0.45, 9.0))
    inside = ((path[:, 2] >= 1.0) & (path[:, 2] <= 1.2)) | (path[:, 0] >= 0.45)
    assert 0 < inside.sum() < len(path)
    program = compile_program(version)
    rows = program.correct_rows(path)
    assert (rows.status == layout.OK).all()
    assert np.array_equal(rows.flags & layout.UNSURE != 0, inside)
    assert np.array_equal(flags_along(program, path), inside)
    read = file.from_bytes(file.to_bytes(program, version_id="v", number=1, robot="r")).program
    assert np.array_equal(flags_along(read, path), inside)
    assert np.array_equal(unexplained_error(version.doubts, path), np.where(inside, 3e-4, 0.0))
    plain = compile_program(version_with())
    assert np.array_equal(plain.correct_rows(path).q, rows.q)
    assert not flags_along(plain, path).any()


def test_a_version_that_is_unsure_everywhere_flags_every_row(path: np.ndarray) -> None:
    version = version_with(Doubt.everywhere(ROBOT.n_joints, 0.0, "refuted"))
    assert [doubt.whole for doubt in version.doubts] == [True]
    assert flags_along(compile_program(version), path).all()
    assert not along(1, 0.0, np.inf).whole


def test_versions_without_doubts_are_stored_as_before() -> None:
    assert "doubts" not in version_with().to_document()
