"""Numbers in cells."""

from __future__ import annotations

import math

NOT_A_NUMBER = ("nan", "na", "n/a", "null")


def parse_number(text: str, decimal: str = ".") -> float | None:
    """Return the number of a cell, NaN for an empty one, None for text. A thousands separator is text.

    A leading apostrophe is a spreadsheet's sign for "keep this as text" and no part of the number.
    """
    text = text.removeprefix("'")
    if not text or text.lower() in NOT_A_NUMBER:
        return math.nan
    if "_" in text or (decimal != "." and "." in text):
        return None
    try:
        value = float(text.replace(decimal, ".", 1))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
