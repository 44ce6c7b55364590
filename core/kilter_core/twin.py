"""A simulated robot with known errors, seeded: for the demo, for teaching, for trying a campaign before measuring it.

It shares the model with the identification, so it proves nothing about the model: tests of the science use generators
of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import STANDARD_GRAVITY, Robot
from kilter_core.effects import Effect, make_effect
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import indices
from kilter_core.types import Floats


@dataclass(frozen=True)
class Twin:
    """A robot with ``errors`` added to its nominal parameters (SI, by name) and the effects it really has."""

    robot: Robot
    errors: Mapping[str, float]
    effects: tuple[Effect, ...] = ()

    @property
    def truth(self) -> Calibration:
        """The calibration an identification should find; what the arm carries hangs on the chain as it is."""
        model = RobotModel(self.robot, self.effects)
        values = model.values0()
        values[indices(model.names, self.errors)] += list(self.errors.values())
        return Calibration(model.with_loads_at_values(values), values)

    def observe(
        self,
        q: Floats,
        *,
        noise_m: float = 0.0,
        seed: int = 0,
        repeats: int = 1,
        direction: Floats | None = None,
        payload_kg: Floats | None = None,
    ) -> Observations:
        """Measured tool positions at joints ``q (N, n)``, each pose ``repeats`` times, with Gaussian noise per axis."""
        which = np.repeat(np.arange(len(q)), repeats)
        rows = Observations(
            q=q[which],
            direction=None if direction is None else direction[which],
            payload_kg=None if payload_kg is None else payload_kg[which],
            pose_id=which.astype(np.int64),
        )
        position = self.truth.predict(rows).position
        noise = np.random.default_rng(seed).normal(0.0, noise_m, position.shape) if noise_m > 0 else 0.0
        return Observations(
            q=rows.q,
            position=position + noise,
            direction=rows.direction,
            payload_kg=rows.payload_kg,
            pose_id=rows.pose_id,
        )


# Thesis tables 3.2 (geometry, printed in mm and deg), 4.3 (clearance tilt and backlash, deg) and 4.4 (stiffness, kgf·m/deg).
_LENGTHS_M = {"a_2": 0.003 * 1e-3, "a_3": 0.01 * 1e-3, "d_4": 0.002 * 1e-3, "d_5": 0.001 * 1e-3}
_ANGLES_RAD = {
    "theta_offset_1": radians(-0.061),
    "theta_offset_2": radians(0.0232),
    "theta_offset_3": radians(-0.057),
    "theta_offset_4": radians(0.0641),
    "theta_offset_5": radians(-0.121),
    "alpha_2": radians(-0.08),
    "alpha_3": radians(0.003),
    "beta_3": radians(0.0021),
    "beta_4": radians(0.0013),
    "alpha_4": radians(-0.01),
    "alpha_5": radians(0.03),
}
_CLEARANCE_RAD = (radians(0.022), radians(0.024), radians(0.017), radians(0.015), radians(0.018))
_BACKLASH_RAD = (radians(0.063), radians(0.061), radians(0.057), radians(0.046), radians(0.051))
_STIFFNESS_KGFM_DEG = (122.0, 90.0, 75.0, 78.0, 80.0)


def thesis_katana(preset: str = "katana450-chapter5") -> Twin:
    """Katana 450 with the geometric errors, clearance tilt, backlash and stiffness of the thesis's tables."""
    errors = _LENGTHS_M | _ANGLES_RAD
    for j in range(5):
        errors[f"clearance_{j + 1}"] = _CLEARANCE_RAD[j]
        errors[f"backlash_load_{j + 1}"] = _BACKLASH_RAD[j]
        errors[f"compliance_{j + 1}"] = radians(1.0) / (_STIFFNESS_KGFM_DEG[j] * STANDARD_GRAVITY)
    effects = tuple(make_effect(e) for e in ("clearance_tilt", "backlash_load", "axial_compliance"))
    return Twin(robot_from_document(preset_document(preset)), errors, effects)
