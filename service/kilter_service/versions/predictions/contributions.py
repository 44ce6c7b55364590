"""How far each effect of a version moves the tool, over poses within the joint limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kilter_service.ground.core import core_model
from kilter_service.ground.db import Database
from kilter_service.ground.wire import to_mm
from kilter_service.versions import store


class Contribution(NamedTuple):
    """Movement of the tool by an effect, mm; None where it acts only with what poses alone do not state."""

    effect: str
    rms_mm: float | None
    largest_mm: float | None


def contributions(database: Database, version_id: str) -> tuple[int, list[Contribution]]:
    """Return the number of poses, and the effects of a version, the largest first."""
    with database.reading() as session:
        calibration = store.calibration(session, version_id)
    arm = [effect for effect in calibration.model.effects if effect.stage != "measurement"]
    kept = calibration.with_effects([effect for effect in arm if core_model.acts_at_rest(effect)])
    rows = core_model.workspace(calibration.robot)
    moved = {}
    for name, shift in kept.model.contribution(rows, kept.values).items():
        size = to_mm(np.linalg.norm(shift, axis=1))
        moved[name.partition("#")[0]] = (float(np.sqrt(np.mean(size**2))), float(size.max()))
    found = [Contribution(effect.id, *moved.get(effect.id, (None, None))) for effect in arm]
    return len(rows), sorted(found, key=lambda one: -(one.rms_mm or 0.0))
