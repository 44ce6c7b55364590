"""Influence of the parameters on the tool point (thesis 3.5), pose by pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter, display_unit_and_scale, indices, mm
from kilter_core.types import Floats

STEP_RAD = math.radians(0.05)  # the deviations of thesis 3.5
STEP_M = 1e-4
STEP_SHARE = STEP_M / 0.005  # of the prior sigma, for parameters that are neither: what 0.1 mm is of a length's


@dataclass(frozen=True)
class Influence:
    """Displacement of the tool point ``moved (N, F)`` m when each of ``names`` alone deviates by its step (SI)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    steps: Floats
    moved: Floats

    @property
    def relative(self) -> Floats:
        """Influence vector k (N, F) of each pose, the largest being 1 (thesis 3.6)."""
        return relative_influence(self.moved)

    def to_document(self) -> list[dict[str, Any]]:
        """Rows {name, step, unit, mean_mm, min_mm, max_mm, mean_k, leads} in falling order of the mean.

        ``leads`` is the share of poses in which the parameter moves the tool more than any other.
        """
        k = self.relative
        first = np.bincount(np.argmax(k, axis=1), minlength=len(self.names)) / len(k)
        rows = []
        for c in np.argsort(-self.moved.mean(axis=0), kind="stable"):
            unit, scale = display_unit_and_scale(self.units[c])
            column = mm(self.moved[:, c])
            rows.append(
                {
                    "name": self.names[c],
                    "step": float(self.steps[c]) * scale,
                    "unit": unit,
                    "mean_mm": float(column.mean()),
                    "min_mm": float(column.min()),
                    "max_mm": float(column.max()),
                    "mean_k": float(k[:, c].mean()),
                    "leads": float(first[c]),
                }
            )
        return rows


def parameter_influence(calibration: Calibration, observations: Observations, names: Sequence[str]) -> Influence:
    """Impose +0.05 deg on angles and +0.1 mm on lengths, one at a time, at every pose (thesis 3.5, figure 3.8).

    Raises:
        OptionError: a name the model does not have.

    """
    model, values = calibration.model, calibration.values
    batch = model.batch(observations)
    still = model.predict(batch, values).position
    chosen = indices(model.names, names)
    steps = np.array([imposed_step(model.parameters[k]) for k in chosen])
    moved = np.empty((len(still), len(chosen)))
    for c, k in enumerate(chosen):
        there = values.copy()
        there[k] += steps[c]
        moved[:, c] = np.linalg.norm(model.predict(batch, there).position - still, axis=1)
    return Influence(tuple(names), tuple(model.parameters[k].unit for k in chosen), steps, moved)


def imposed_step(parameter: Parameter) -> float:
    """Deviation imposed on a parameter, SI."""
    return {"rad": STEP_RAD, "m": STEP_M}.get(parameter.unit, STEP_SHARE * parameter.prior_sigma)


def relative_influence(moved: Floats) -> Floats:
    """Scale displacements (N, F) so that the largest of each pose is 1; a pose that nothing moves has all zero."""
    largest = moved.max(axis=1, keepdims=True)
    return np.asarray(moved / np.where(largest > 0.0, largest, 1.0))
