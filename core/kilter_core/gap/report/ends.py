"""Amplitudes that a version holds at the end of their physical range, because the rows ask for more."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from kilter_core.model import Calibration
from kilter_core.parameters import reported


def at_ends(calibration: Calibration) -> Iterator[dict[str, Any]]:
    """A warning for every amplitude that is at an end of its range, other than nominal."""
    model = calibration.model
    start = model.n_geometric
    for p, value in zip(model.parameters[start:], calibration.values[start:], strict=True):
        end = next(
            (e for e in (p.lower, p.upper) if np.isfinite(e) and np.isclose(value, e, rtol=1e-9, atol=0.0)), None
        )
        if end is None or end == p.value:
            continue
        unit, scale = reported(p.unit)
        size = f"{end * scale:.3g} {unit}".removesuffix(" 1")
        yield {
            "code": "at_end_of_range", "parameter": p.name, "value": end * scale, "unit": unit,
            "message": f"{p.name} would come out beyond what is physical and is held at {size}: something else is in it. "
            "Check units, masses and payloads, and search again with `effects` that leave it out.",
        }  # fmt: skip
