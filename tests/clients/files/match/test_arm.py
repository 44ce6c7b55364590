"""The client's arm is the server's: the same poses at the same joints, whatever the convention."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document, preset_names
from kilter_core.model import Calibration
from kilter_core.model.geometry import arm_screws
from kilter_files.match.lag_evidence import fit_arm_errors, register
from kilter_files.match.rigid_body import Arm, arm_from_check
from kilter_service.robots.check import check
from kilter_service.robots.documents import convert
from kilter_service.robots.wire import DOCUMENT

SLIDING = {
    "name": "gantry", "convention": "chain",
    "base": {"x_mm": 100, "y_mm": 0, "z_mm": 50, "rx_deg": 10, "ry_deg": 20, "rz_deg": 30},
    "tool": {"x_mm": 5, "y_mm": 6, "z_mm": 70, "rx_deg": 40, "ry_deg": -20, "rz_deg": 15},
    "joints": [{"name": "rail", "limits_mm": [0, 900]}, {"name": "turn", "limits_deg": [-90, 90]}],
    "elements": [{"joint": "rail", "axis": "Tx"}, {"name": "h", "axis": "Tz", "value": 300}, {"joint": "turn", "axis": "Ry"},
                 {"name": "a", "axis": "Tx", "value": 200}],
}  # fmt: skip


def both(document: dict[str, object], q: np.ndarray) -> tuple[Arm, np.ndarray]:
    validated = DOCUMENT.validate_python(document)
    arm = arm_from_check(check(validated).model_dump(mode="json"))
    posted = validated.model_dump(mode="json", exclude_none=True)
    robot = robot_from_document(preset_document(posted["preset"]) if posted["convention"] == "preset" else posted)
    return arm, arm_screws(Calibration.nominal(robot)).compose_with_poses(robot.T_base, np.eye(4)).poses(q)


@pytest.mark.parametrize("name", [*preset_names(), "gantry", "ur10 as mdh"])
def test_poses_are_the_cores(name: str) -> None:
    preset = {"name": "a", "convention": "preset", "preset": name.partition(" ")[0]}
    document = SLIDING if name == "gantry" else preset
    if name.endswith("mdh"):
        document = DOCUMENT.dump_python(
            DOCUMENT.validate_python(convert(DOCUMENT.validate_python(preset), "mdh")), exclude_none=True
        )
    count = len(check(DOCUMENT.validate_python(document)).joints)
    q = np.random.default_rng(0).uniform(-1, 1, (40, count))
    arm, truth = both(document, q)
    own = q.copy()
    own[:, sorted({int(j) for j in arm.joint[arm.slides]})] *= 1e3
    turns, places = arm.poses(own)
    assert np.abs(turns - truth[:, :3, :3]).max() < 1e-9
    assert np.abs(places - truth[:, :3, 3] * 1e3).max() < 1e-6


def test_a_registration_finds_base_and_markers_and_small_errors_of_the_arm() -> None:
    arm, _ = both({"name": "a", "convention": "preset", "preset": "ur10"}, np.zeros((1, 6)))
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.5, 1.5, (40, 6))
    bent = q + np.radians([0.05, -0.1, 0.08, 0, 0.1, 0]) + 1e-3 * np.sin(q)
    turns, places = arm.poses(bent)
    markers = rng.normal(0, 90, (3, 3))
    points = np.einsum("nij,mj->nmi", turns, markers) + places[:, None] + [500, -900, 1200]
    points[rng.random((40, 3)) < 0.1] = np.nan
    found = register(*arm.poses(q), points)
    off = found.predict_markers(*arm.poses(q)) - points
    assert 0.1 < np.sqrt(np.nanmean(off**2)) < 3.0
    better, columns = fit_arm_errors(arm, q, points, found)
    assert np.nanmax(np.abs(better.predict_markers(*arm.poses(q), columns) - points)) < 0.05
