"""Parameters of one joint from readings that each have the offset of their series: linear least squares, shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.types import Floats


@dataclass(frozen=True)
class JointParameter:
    """One measured parameter, SI; ``reason`` says why it could not be measured."""

    name: str
    joint: int
    unit: str
    value: float | None
    sigma: float | None
    readings: int
    reason: str | None = None


@dataclass(frozen=True)
class LinearFit:
    """Least squares over the columns that are ``told`` apart and the offsets: ``A (N, K)``, solution and what is left."""

    A: Floats
    solution: Floats
    left: Floats
    told: tuple[int, ...]

    @staticmethod
    def from_columns(columns: Floats, told: Sequence[int], offsets: Floats, y: Floats) -> LinearFit:
        """Fit these of the columns (N, C), and every offset (N, S)."""
        A = np.hstack([columns[:, list(told)], offsets])
        solution = np.asarray(np.linalg.lstsq(A, y, rcond=None)[0])
        return LinearFit(A, solution, y - A @ solution, tuple(told))

    def parameters(
        self, joint: int, names: Sequence[tuple[str, str]], sigma: Floats, reasons: Sequence[str]
    ) -> list[JointParameter]:
        """One parameter for each (stem, unit), with the reason where its column was not told apart."""
        out = []
        for k, ((stem, unit), reason) in enumerate(zip(names, reasons, strict=True)):
            place = self.told.index(k) if k in self.told else None
            value, wide = (None, None) if place is None else (float(self.solution[place]), float(sigma[place]))
            why = reason if place is None else None
            out.append(JointParameter(f"{stem}_{joint + 1}", joint, unit, value, wide, len(self.left), why))
        return out


def residual_norm(column: Floats, others: Floats) -> float:
    """Length of what of a column (N,) no combination of others (N, K) makes up."""
    return float(np.linalg.norm(column - others @ np.linalg.lstsq(others, column, rcond=None)[0]))
