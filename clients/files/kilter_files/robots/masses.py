"""Masses of the links in a DH or MDH table, filled for every row or for none, and the cells of such a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError

LENGTHS = {"mm": 1.0, "m": 1e3}
CENTRE = ("com_x", "com_y", "com_z")
INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
QUANTITIES = ("mass", *CENTRE, *INERTIA)
UNITS = {"mass": ("kg",), **dict.fromkeys(CENTRE, tuple(LENGTHS)), **dict.fromkeys(INERTIA, ("kg_m2",))}
NAMES = tuple(f"{quantity}_{units[0]}" for quantity, units in UNITS.items())
Cells = Mapping[str, float | None]


def mass_column(plain: str) -> tuple[str, str] | None:
    """Return quantity and unit of a column about masses; None for any other name."""
    return next(((q, unit) for q, units in UNITS.items() for unit in units if plain == f"{q}_{unit}"), None)


def refuse_half_a_group(sheet: Sheet, present: set[str]) -> None:
    """Mass and centre go together, and so do the six numbers of the inertia.

    Raises:
        FileError: a column is missing; the message names it.

    """
    wanted = ("mass", *CENTRE, *(INERTIA if present & set(INERTIA) else ()))
    missing = [q for q in wanted if q not in present] if present & set(QUANTITIES) else []
    if missing:
        column = f"{missing[0]}_{UNITS[missing[0]][0]}"
        raise FileError(
            f"{sheet.path}: has masses, but no column {column!r}. Give {', '.join(NAMES[:4])}, and all of "
            f"{', '.join(NAMES[4:])} or none of them.",
            file=str(sheet.path),
            column=column,
        )


def links(sheet: Sheet, rows: list[tuple[int, Cells]]) -> list[dict[str, Any]]:
    """Return the links of a robot document from each row's line and cells; none where no cell is filled.

    Raises:
        FileError: some cells are filled and another is not, or a mass is negative; the message names row and column.

    """
    filled = {quantity for _, cells in rows for quantity, value in cells.items() if value is not None}
    if not filled:
        return []
    inertia = bool(filled & set(INERTIA))
    return [_link(sheet, line, cells, inertia) for line, cells in rows]


def _link(sheet: Sheet, line: int, cells: Cells, inertia: bool) -> dict[str, Any]:
    mass = _number(sheet, line, cells, "mass")
    if mass < 0:
        raise _error(sheet, line, "mass", f"{mass:g} kg: a mass cannot be negative.")
    if mass == 0 and all(value is None for quantity, value in cells.items() if quantity != "mass"):
        return {"mass_kg": 0.0}  # no mass, so no centre either
    link: dict[str, Any] = {"mass_kg": mass, "com_mm": [_number(sheet, line, cells, q) for q in CENTRE]}
    if inertia:
        link["inertia_kg_m2"] = [_number(sheet, line, cells, q) for q in INERTIA]
        _refuse_no_body(sheet, line, link["inertia_kg_m2"])
    return link


def _refuse_no_body(sheet: Sheet, line: int, values: list[float]) -> None:
    """A product of inertia above what its two moments allow is a swapped column or a wrong unit."""
    xx, yy, zz, xy, xz, yz = values
    for name, moment in zip(INERTIA, (xx, yy, zz), strict=False):
        if moment < 0:
            raise _error(sheet, line, name, f"{moment:g} kg m2: a moment of inertia cannot be negative.")
    for name, product, a, b in (("ixy", xy, xx, yy), ("ixz", xz, xx, zz), ("iyz", yz, yy, zz)):
        most = math.sqrt(a * b) * (1 + 1e-6) + 1e-12  # figures of a table are rounded
        if abs(product) > most:
            raise _error(sheet, line, name, f"{product:g} kg m2 is more than the moments allow, {most:.4g} kg m2.")


def _number(sheet: Sheet, line: int, cells: Cells, quantity: str) -> float:
    value = cells.get(quantity)
    if value is None:
        raise _error(
            sheet,
            line,
            quantity,
            "is empty while others are filled. Give every row its mass and centre of mass, 0 kg where a link has none.",
        )
    return value


def _error(sheet: Sheet, line: int, quantity: str, what: str) -> FileError:
    column = next((n for n in sheet.names if (mass_column(plain_name(n)) or ("",))[0] == quantity), quantity)
    return FileError(
        f"{sheet.path}, line {line}, column {column!r}: {what}", file=str(sheet.path), line=line, column=column
    )


def plain_name(name: str) -> str:
    """Return a column's name as it is compared: small letters, no spaces."""
    return name.strip().lower().replace(" ", "_")


@dataclass
class Sheet:
    """Cells of a table with the line each row stood on, and its comments."""

    path: Path
    names: list[str]
    rows: list[tuple[int, list[str]]]
    comments: list[str] = field(default_factory=list)
    decimal: str = "."
