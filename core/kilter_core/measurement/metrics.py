"""Errors of a prediction against measurements, in the units people read: mm and degrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.parameters import degrees, mm
from kilter_core.types import Floats


@dataclass(frozen=True)
class Errors:
    """Point errors (K, 3) m, measured minus predicted, and orientation errors (K,) rad where measured.

    Distances and contacts have errors of one number, (K, 1).
    """

    points: Floats
    turns: Floats | None

    @staticmethod
    def from_calibration(calibration: Calibration, measurement: Measurement) -> Errors:
        """Errors of a calibration; every seen marker counts as a point."""
        return Errors(*measurement.errors(calibration))

    @property
    def mean(self) -> float:
        """Mean size of the errors of points, m."""
        return float(np.linalg.norm(self.points, axis=1).mean())

    @staticmethod
    def concatenate(parts: list[Errors]) -> Errors:
        """Pool the errors of several folds."""
        turns = [part.turns for part in parts if part.turns is not None]
        return Errors(np.concatenate([p.points for p in parts]), np.concatenate(turns) if turns else None)

    def to_document(self) -> dict[str, float]:
        """Mean, rms, 95th percentile and maximum of the 3-D error, rms per axis, in mm; mean orientation error in deg."""
        size = mm(np.asarray(np.linalg.norm(self.points, axis=1)))
        out = {
            "mean_mm": size.mean(),
            "rms_mm": np.sqrt(np.mean(size**2)),
            "p95_mm": np.percentile(size, 95),
            "max_mm": size.max(),
        }
        if self.points.shape[1] == 3:
            axes = mm(np.asarray(np.sqrt(np.mean(self.points**2, axis=0))))
            out |= dict(zip(("x_mm", "y_mm", "z_mm"), axes, strict=True))
        if self.turns is not None:
            out["orientation_deg"] = degrees(self.turns.mean())
        return {key: float(value) for key, value in out.items()}


def metrics_document(train: dict[str, Errors], held: dict[str, Errors], left_out: int = 0) -> dict[str, Any]:
    """The ``metrics`` of the contract: each stage's errors on the rows fitted and, unless empty, on those held out.

    ``left_out`` rows held out are not among the latter.
    """

    def block(errors: dict[str, Errors], without: int) -> dict[str, Any]:
        n = len(next(iter(errors.values())).points)
        return {"n": n, "left_out": without, **{name: e.to_document() for name, e in errors.items()}}

    return {"train": block(train, 0), "validation": block(held, left_out) if held else None}
