"""How a mean error is said: in the unit of the largest number that stands beside it, wherever it is said."""

from __future__ import annotations

import math

from kilter_service.contract.comparison_words import unit_of_length
from kilter_service.contract.fits import Errors

DIGITS = 3  # of a mean error in a sentence
QUANTILE = 1.96  # of the standard normal at 97.5 %


def interval(found: Errors, n: int | None) -> tuple[float, float] | None:
    """Return the 95 % interval of a mean error over ``n`` points, mm; None where the spread is not known."""
    if not n or n < 2 or found.rms_mm is None:
        return None
    variance = max(found.rms_mm**2 - found.mean_mm**2, 0.0) * n / (n - 1)
    half = QUANTILE * math.sqrt(variance / n)
    return max(found.mean_mm - half, 0.0), found.mean_mm + half


def widest(found: Errors, n: int | None) -> float:
    """Return the largest of a mean error, the ends of its interval and its 95 % quantile, mm: its unit is that of all."""
    beside = (found.mean_mm, found.p95_mm, *(interval(found, n) or ()))
    return float(max(one for one in beside if one is not None))


def said_of_error(value_mm: float, largest_mm: float) -> str:
    """Write an error in the unit of the largest, with three digits of its own."""
    unit, scale = unit_of_length(largest_mm)
    scaled = scale * value_mm
    if not scaled or not math.isfinite(scaled):
        return f"{scaled:g} {unit}"
    decimals = max(DIGITS - 1 - math.floor(math.log10(abs(scaled))), 0)
    return f"{round(scaled, decimals):.{decimals}f} {unit}"
