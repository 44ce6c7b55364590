"""How a comparison is said: lengths that stand beside each other have the unit of the largest."""

from __future__ import annotations

import math


def said_of_lengths(largest_mm: float, *lengths_mm: float) -> list[str]:
    """Write lengths in µm where the largest is below a tenth of a millimetre, else in mm, with its digits."""
    unit, scale = ("µm", 1e3) if abs(largest_mm) < 0.1 else ("mm", 1.0)
    digits = max(2 - math.floor(math.log10(scale * abs(largest_mm))), 0) if largest_mm else 0
    return [f"{round(scale * one, digits) + 0.0:.{digits}f} {unit}" for one in lengths_mm]


def said_of_chance(value: float) -> str:
    """Write a probability: as a number where people read it so, as a power of ten where it is tiny."""
    return f"{value:.0e}".replace("e-0", "e-") if value < 1e-3 else f"{value:.2g}"
