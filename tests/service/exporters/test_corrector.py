"""The program for the corrector in C, and the C file that holds it."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kilter_core.correct.file import HEADER
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_service.robots.exporters.registry import export
from tests.core.correct.c_corrector import COMPILER, WARNINGS, Corrector, built
from tests.service.exporters.test_exporters import ERRORS, calibrated

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return built(tmp_path_factory.mktemp("c"))


def test_the_file_is_the_version_within_its_limits(library: ctypes.CDLL) -> None:
    version, calibration = calibrated(ERRORS, "katana450-chapter5")
    written = export("corrector", version)
    assert isinstance(written.text, bytes)
    assert written.name == f"{version.version.robot}-ver_1a.klt"
    ours = Corrector(library, written.text)
    assert ours.loaded == 0
    assert (ours.state.version, ours.state.robot.decode()) == (b"ver_1a", version.version.robot)
    limits = version.version.limits
    options = CorrectionOptions(
        largest_rad=np.radians(limits.max_joint_deg),
        largest_m=limits.max_position_mm * 1e-3,
        farthest_m=limits.max_position_mm * 1e-3,
        at_limit=limits.at_limit,
    )
    q = np.random.default_rng(1).uniform(-0.8, 0.8, (20, calibration.robot.n_joints))
    rows = compile_program(calibration, options).correct_rows(q)
    for k, row in enumerate(q):
        status, joints, answer = ours.correct_alone(row, np.zeros(len(row)))
        assert (status, answer.flags) == (rows.status[k], rows.flags[k])
        assert np.allclose(joints, rows.q[k], rtol=0, atol=1e-12)


def test_the_c_file_compiles_alone_and_holds_the_same_program(tmp_path: Path) -> None:
    version, _ = calibrated(ERRORS)
    source = tmp_path / "arm.c"
    text = export("c", version).text
    assert isinstance(text, str)
    source.write_text(text)
    made = tmp_path / "arm.so"
    subprocess.run([str(COMPILER), *WARNINGS, "-shared", "-fPIC", "-o", str(made), str(source), "-lm"], check=True)
    content = export("corrector", version).text
    assert isinstance(content, bytes)
    held = (ctypes.c_ubyte * len(content)).in_dll(ctypes.CDLL(str(made)), "kc_program")
    assert bytes(held) == content
    assert HEADER.unpack(content[: HEADER.size])[9].rstrip(b"\0") == b"ver_1a"


def test_what_a_file_cannot_correct_is_named() -> None:
    version, calibration = calibrated(ERRORS)
    from dataclasses import replace

    from kilter_core.effects import make_effect
    from kilter_core.model import Calibration, RobotModel

    model = RobotModel(calibration.robot, (make_effect("thermal_growth"),))
    grown = Calibration(model, model.values0())
    notes = export("corrector", replace(version, document=grown.to_document())).notes
    assert any("thermal_growth" in note for note in notes)
