"""Versions of robots in complete models are exported like any others."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.conversions import robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.model import Calibration
from kilter_core.twin import Twin
from kilter_service.robots.importers.urdf import chain_document
from tests.service.exporters.test_exporters import export, exportable, joints, poses_of


@pytest.mark.parametrize("convention", ["poe", "cpc", "mcpc", "s_model"])
def test_the_urdf_of_a_calibrated_complete_model_has_its_poses(convention: str) -> None:
    document = robot_document(robot_from_document(preset_document("ur10")), convention)
    robot = robot_from_document(document)
    rng = np.random.default_rng(0)
    names = [
        str(robot.chain.elements[k].name) for k in robot.chain.named_elements if not robot.chain.elements[k].dependent
    ]
    calibration = Twin(robot, {name: float(rng.normal(0.0, 5e-4)) for name in names}).truth
    file = exportable(document, calibration)
    again = robot_from_document(chain_document(export("urdf", file).text, "base_link", "flange", "again").document)
    q = joints(6)
    assert np.abs(poses_of(Calibration.nominal(again), q) - poses_of(calibration, q)).max() < 1e-9
    assert "theta_offset_deg" in export("mdh-csv", file).text
