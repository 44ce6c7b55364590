"""A column of numbers, described."""

from __future__ import annotations

from kilter_files.formats.reader import Document
from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np


def column(name: str, unit: str | None, values: Floats) -> Document:
    """Describe a column of numbers: unit, range, and how many cells are empty."""
    known = values[~np.isnan(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (None, None)
    return {"name": name, "unit": unit, "low": low, "high": high, "empty": len(values) - len(known)}
