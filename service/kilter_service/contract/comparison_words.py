"""How a comparison is said: lengths that stand beside each other have the unit of the largest."""

from __future__ import annotations

import math

DIGITS = 3  # of the largest of several lengths
SMALLEST = 1e-6  # of probabilities that anybody tells apart


def unit_of_length(length_mm: float) -> tuple[str, float]:
    """The unit in which people read a length, and how many there are in a millimetre."""
    return ("µm", 1e3) if abs(length_mm) < 0.1 else ("mm", 1.0)


def said_of_lengths(largest_mm: float, *lengths_mm: float) -> list[str]:
    """Write lengths in the unit of the largest, as finely as three digits of it."""
    unit, scale = unit_of_length(largest_mm)
    digits = max(DIGITS - 1 - math.floor(math.log10(scale * abs(largest_mm))), 0) if largest_mm else 0
    return [f"{round(scale * one, digits) + 0.0:.{digits}f} {unit}" for one in lengths_mm]


def said_of_chance(value: float) -> str:
    """Write a probability: as a number where people read it so, as a power of ten where it is tiny."""
    if value < SMALLEST:
        return f"below {SMALLEST:.0e}".replace("e-0", "e-")
    return f"{value:.0e}".replace("e-0", "e-") if value < 1e-3 else f"{value:.2g}"
