"""Poses and exact Jacobian of 118 poses by 40 parameters, with and without tilting."""

from __future__ import annotations

import numpy as np

from benchmarks.table import Line, best_of
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import make_effect
from kilter_core.model import RobotModel
from kilter_core.observations import Observations

ROWS, PARAMETERS, TARGET_MS = 118, 40, 1.0


def lines() -> list[Line]:
    """Time of one Jacobian of the geometric model and of full tilting on the Katana."""
    ur10 = robot_from_document(preset_document("ur10"))
    katana = robot_from_document(preset_document("katana450-chapter5"))
    tilting = tuple(make_effect(e) for e in ("clearance_tilt", "backlash_load", "axial_compliance"))
    plain = _milliseconds(RobotModel(ur10))
    tilted = _milliseconds(RobotModel(katana, tilting))
    what = f"model and Jacobian, {ROWS} poses x {PARAMETERS} parameters"
    return [
        Line(f"{what}: geometry", f"{plain:.3f} ms", f"<= {TARGET_MS:g} ms", plain <= TARGET_MS),
        Line(f"{what}: full tilting", f"{tilted:.3f} ms"),
    ]


def _milliseconds(model: RobotModel) -> float:
    rng = np.random.default_rng(0)
    batch = model.batch(Observations(rng.uniform(-1.5, 1.5, (ROWS, model.robot.n_joints))))
    values = model.values0() + rng.normal(0.0, 1e-4, len(model.names))
    count = len(model.names)
    free = np.arange(count)[max(0, count - PARAMETERS) :]
    return best_of(lambda: model.jacobian(batch, values, free), 200) * 1e3
