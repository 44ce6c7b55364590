"""The twin of a version that `kilter robot kit` makes: backlash that changes sides over 0.005 N m is a hinge with limits."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import make_effect
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.twin import Twin
from kilter_service.robots.exporters.registry import Exported, export
from tests.clients.lerobot.so101_twin import gravity_nm
from tests.service.exporters.test_exporters import exportable
from tests.service.exporters.test_mjcf import CLOSE_WITH_BACKLASH_UM, settled

Floats = NDArray[np.float64]
SOFTENING_NM = 0.005  # as the kit asks for it
LOADED_NM = 0.08


@cache
def servos(softening_nm: float = SOFTENING_NM, wrist_rad: float = -1e-4) -> tuple[Exported, Calibration]:
    """An SO-101 with backlash of a degree in its elbow, and in its wrist what noise leaves below 0."""
    document = preset_document("so101")
    values = {"compliance_2": 1 / 33, "compliance_3": 1 / 28, "compliance_4": 1 / 40, "backlash_load_2": 2e-3,
              "backlash_load_3": math.radians(0.5), "backlash_load_4": wrist_rad}  # fmt: skip
    backlash = make_effect("backlash_load", joints=(1, 2, 3), softening_nm=softening_nm)
    effects: tuple[Any, ...] = (make_effect("axial_compliance", joints=(1, 2, 3)), backlash)
    arm = Twin(robot_from_document(document), values, effects).truth
    return export("mjcf", exportable(document, arm)), arm


def loaded_poses(count: int) -> list[Floats]:
    """Readings, rad, at which gravity loads shoulder, elbow and wrist clearly with either payload, by MuJoCo."""
    drawn = np.random.default_rng(6).uniform(-1.0, 1.0, (60 * count, 5)) * [60.0, 70.0, 70.0, 70.0, 140.0]
    clear = (q for q in drawn if all(np.abs(gravity_nm(q, kg)[1:4]).min() > LOADED_NM for kg in (0.0, 0.2)))
    return [np.radians(q) for q, _ in zip(clear, range(count), strict=False)]


@pytest.mark.parametrize("step_s", [1e-3, 2e-3, 5e-3])
def test_what_the_kit_finds_settles_where_its_version_says(step_s: float) -> None:
    exported, arm = servos()
    model = mujoco.MjModel.from_xml_string(str(exported.text))
    limits = model.joint("elbow_flex_backlash").range
    assert limits == pytest.approx([-math.radians(0.5), math.radians(0.5)])
    apart = []
    for q in loaded_poses(4):
        for payload_kg in (0.0, 0.2):
            for side in (-1.0, 1.0):
                rows = Observations(q[None], direction=np.full((1, 5), side), payload_kg=np.array([payload_kg]))
                found = settled(model, q, side, payload_kg, step_s, every=8, seconds=4.0)[0]
                apart.append(np.linalg.norm(found - arm.predict(rows).position[0]) * 1e6)
    assert len(apart) == 16
    assert max(apart) < CLOSE_WITH_BACKLASH_UM


def test_the_notes_say_which_joints_the_step_adds_and_which_change_sides_at_once() -> None:
    said = servos()[0].notes
    assert sum(": backlash_load, worth " in line for line in said) == 1
    assert any(line.startswith("In the model, and of some joints added by the step in Python") for line in said)
    assert any(
        "(shoulder_lift 0.005 N m, elbow_flex 0.005 N m), so where less than three times" in line for line in said
    )
    whole = servos(wrist_rad=1e-4)[0].notes
    assert any(line.startswith("In the model: backlash_load, worth ") for line in whole)
    soft = servos(softening_nm=0.5)[0]
    assert any(
        line.startswith("Added by the step in Python (kilter.twin.apply) only: backlash_load") for line in soft.notes
    )
    assert not any("changes at once" in line for line in soft.notes)
    assert "elbow_flex_backlash" not in str(soft.text)
