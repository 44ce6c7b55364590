"""Estimates with no more digits than their uncertainty allows: two significant digits of sigma, as the GUM has it."""

from __future__ import annotations

import math
from typing import Any

Z95 = 1.959964  # half width of a 95 % interval of a normal distribution, in standard deviations
MOST_DECIMALS = 6  # beyond that many zeros a power of ten is easier to read ...
PLAIN_FROM = 0.01  # ... of a number that begins with them: 90.0000049 stays plain
UNKNOWN_DIGITS = 4  # of a value whose uncertainty nobody knows


def decimals(sigma: Any) -> int | None:
    """Return the decimals that two significant digits of ``sigma`` reach; below 0 are tens; None without a sigma."""
    if not isinstance(sigma, int | float) or not math.isfinite(sigma) or sigma <= 0:
        return None
    two = float(f"{sigma:.1e}")  # 0.0996 is 0.10: one decimal less
    return 1 - math.floor(math.log10(two) + 1e-9)


def estimate(value: Any, places: int | None) -> str:
    """Write a number with this many decimals, nothing for None."""
    if value is None:
        return ""
    if places is None:
        return f"{value:.{UNKNOWN_DIGITS}g}"
    rounded = round(float(value), places) + 0.0  # no -0
    if places <= MOST_DECIMALS or abs(rounded) >= PLAIN_FROM:
        return f"{rounded:.{max(places, 0)}f}"
    if rounded == 0.0:
        return "0"
    return f"{rounded:.{max(0, math.floor(math.log10(abs(rounded))) + places)}e}"


def ends(value: float | None, sigma: float | None, lower: float | None, upper: float | None) -> str:
    """Write the 95 % interval as ``from to``: as it was computed, else 1.96 sigma to either side."""
    places = decimals(sigma)
    if lower is None or upper is None:
        if value is None or sigma is None:
            return ""
        lower, upper = value - Z95 * sigma, value + Z95 * sigma
    return f"{estimate(lower, places)} to {estimate(upper, places)}"
