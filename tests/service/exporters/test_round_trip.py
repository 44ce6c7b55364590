"""Whatever geometric errors a version has: exported and read back by the readers of robot files, the same poses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kilter_core.arm.documents import robot_from_document
from kilter_core.model import Calibration
from kilter_files.robots import Described, read_robot
from kilter_service.robots.documents import core_document
from kilter_service.robots.exporters.registry import export
from kilter_service.robots.importers.urdf import chain_document
from tests.service.exporters.test_exporters import calibrated, joints, poses_of

NAMES = [
    *(f"a_{k}" for k in (2, 3)), *(f"alpha_{k}" for k in (1, 2, 3, 4, 5)), *(f"d_{k}" for k in (1, 4, 5)),
    *(f"theta_offset_{k}" for k in range(1, 7)), "beta_2", "beta_3", "base_x", "base_ry", "base_rz",
]  # fmt: skip
TOOL = ["tool_x", "tool_y", "tool_z", "tool_rx", "tool_ry", "tool_rz"]
SIZES = st.floats(-3e-3, 3e-3).filter(lambda v: v == 0 or abs(v) > 1e-7)
ERRORS = st.dictionaries(st.sampled_from(NAMES), SIZES, max_size=8)
WITH_TOOL = st.dictionaries(st.sampled_from(NAMES + TOOL), SIZES, max_size=8)
BOUNDED = settings(
    max_examples=12, deadline=None, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip


@pytest.mark.parametrize("form", ["urdf", "mdh-csv", "json"])
@BOUNDED
@given(errors=WITH_TOOL)
def test_exported_and_read_back(tmp_path: Path, form: str, errors: dict[str, float]) -> None:
    file, calibration = calibrated(errors, tool={"x_mm": 20.0, "z_mm": 100.0, "rx_deg": 20.0})
    written, path, q = export(form, file), tmp_path / "arm.csv", joints(6, 8)
    path.write_text(written.text)
    if form == "json":
        document = json.loads(written.text)
        again = Calibration.from_document(calibration.robot, document["calibration_si"])
        assert "covariance" in document["version"]
    elif form == "urdf":
        again = Calibration.nominal(
            robot_from_document(chain_document(written.text, "base_link", "tool", "a").document)
        )
    else:
        document = read_robot(path, Described("again", convention="mdh"))
        again = Calibration.nominal(robot_from_document(core_document(document).document))
    # a table has its base beside its rows, and poses are told in the base's frame
    base = again.robot.T_base if form == "mdh-csv" else np.eye(4)
    assert np.abs(base @ poses_of(again, q) - poses_of(calibration, q)).max() < 1e-9


@BOUNDED
@given(errors=ERRORS)
def test_the_calibration_of_a_universal_robot_read_back(tmp_path: Path, errors: dict[str, float]) -> None:
    small = {name: value / 10 for name, value in errors.items() if not name.startswith("base")}
    file, calibration = calibrated(small)
    path = tmp_path / "arm.yaml"
    path.write_text(export("ur-yaml", file).text)
    document = read_robot(path, Described("again", model="ur10"))
    again = Calibration.nominal(robot_from_document(core_document(document).document))
    q = joints(6, 8)
    assert np.abs(poses_of(again, q) - poses_of(calibration, q)).max() < 1e-9
