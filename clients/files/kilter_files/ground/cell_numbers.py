"""Numbers in cells, and cells that hold a list of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

NOT_A_NUMBER = ("nan", "na", "n/a", "null")

ELEMENT = re.compile(r"(?P<name>.*\S)\s*(?:\[\s*(?P<from0>\d{1,4})\s*\]|\(\s*(?P<from1>\d{1,4})\s*\))")
WRAPPED = re.compile(r"(?:[A-Za-z_.]{0,20}\(\s*)?[\[({](.*)[\])}]\s*\)?", re.DOTALL)


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


def parse_element_name(name: str) -> tuple[str, int] | None:
    """Return column and index (from 0) of ``q[0]`` or ``q(1)``, None for a plain name."""
    match = ELEMENT.fullmatch(name.strip())
    if match is None:
        return None
    index = int(match["from0"]) if match["from0"] is not None else int(match["from1"]) - 1
    return (match["name"], index) if index >= 0 else None


def parse_list(text: str, decimal: str = ".") -> list[float] | None:
    """Return the numbers of a cell such as ``[1, 2]``, ``(1; 2)`` or numpy's ``[1. 2.]``; None for anything else."""
    match = WRAPPED.fullmatch(text.strip())
    if match is None:
        return None
    inner = re.sub(r"[\[\](){}]", " ", match[1]).strip()
    separators = r"\s*;\s*|\s+" if decimal == "," else r"\s*[,;]\s*|\s+"
    parts = re.split(separators, inner) if inner else []
    values = [parse_number(part, decimal) if part else None for part in parts]
    return [value for value in values if value is not None] if None not in values else None


def elements(name: str, cell: str, decimal: str) -> list[str]:
    """Return ``name[0]``, ``name[1]``, ... of a column whose first cell is a list, none otherwise."""
    found = parse_list(cell, decimal)
    return [] if found is None else [f"{name}[{k}]" for k in range(len(found))]


def element(texts: list[str], index: int, decimal: str, wrong: Callable[[int, str], Exception]) -> list[str]:
    """Return the cells' element ``index`` as text; empty cells stay empty.

    Raises:
        Exception: what ``wrong(row, why)`` makes of a cell that is not a list, or not as long as the first.

    """
    out, length = [], None
    for row, text in enumerate(texts):
        if not text:
            out.append("")
            continue
        found = parse_list(text, decimal)
        if found is None:
            raise wrong(row, f"{text[:40]!r} is not a list of numbers such as [1.0, 2.0]")
        length = len(found) if length is None else length
        if len(found) != length or not index < length:
            why = f"has no element {index} (from 0)" if len(found) == length else f"the first list has {length}"
            raise wrong(row, f"a list of {len(found)} numbers: {why}")
        out.append(repr(found[index]).replace(".", decimal))
    return out
