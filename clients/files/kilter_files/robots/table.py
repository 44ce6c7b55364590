"""DH and MDH tables, one row per joint, from CSV and XLSX."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, UsageError, did_you_mean
from kilter_files.ground.later import need
from kilter_files.ground.workbook_formulas import REMEDY, describe_cells, formulas_without_value, unpacked_bytes
from kilter_files.robots.exported import read_text

CENTRE = ("com_x", "com_y", "com_z")
INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
LENGTHS = {"mm": 1.0, "m": 1e3}
MASS_QUANTITIES = ("mass", *CENTRE, *INERTIA)
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
    missing = [q for q in wanted if q not in present] if present & set(MASS_QUANTITIES) else []
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
    mass = _mass_number(sheet, line, cells, "mass")
    if mass < 0:
        raise _error(sheet, line, "mass", f"{mass:g} kg: a mass cannot be negative.")
    if mass == 0 and all(value is None for quantity, value in cells.items() if quantity != "mass"):
        return {"mass_kg": 0.0}  # no mass, so no centre either
    link: dict[str, Any] = {"mass_kg": mass, "com_mm": [_mass_number(sheet, line, cells, q) for q in CENTRE]}
    if inertia:
        link["inertia_kg_m2"] = [_mass_number(sheet, line, cells, q) for q in INERTIA]
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


def _mass_number(sheet: Sheet, line: int, cells: Cells, quantity: str) -> float:
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


MAX_BYTES = 20_000_000  # unpacked: a table of a robot is a few kilobytes
MAX_ROWS = 200


def read_workbook(path: Path) -> Sheet:
    """Read the first sheet; values of formulas are those last computed.

    Raises:
        FileError: no workbook, or far bigger than a table of a robot.
        MissingPackageError: openpyxl is not installed.

    """
    openpyxl = need(f"{path}: Workbooks (.xlsx) need", "openpyxl", instead="save the sheet as CSV")
    _refuse_large(path)
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheet = book.worksheets[0]
        found = list(enumerate(sheet.iter_rows(values_only=True, max_row=MAX_ROWS), 1))
        book.close()
        uncomputed = formulas_without_value(openpyxl, path, 0, MAX_ROWS)
    except Exception as error:  # of a damaged workbook openpyxl, zipfile, zlib and the XML parser each raise their own
        raise FileError(f"{path}: is not a workbook that can be read ({error}).", file=str(path)) from error
    if uncomputed:
        raise FileError(f"{path}: {describe_cells(uncomputed)}. {REMEDY}", file=str(path), line=uncomputed[0][0])
    rows = [(line, [_text(cell) for cell in cells]) for line, cells in found]
    return _sheet(path, [(line, cells) for line, cells in rows if any(cells)])


def _sheet(path: Path, rows: list[tuple[int, list[str]]]) -> Sheet:
    comments = [cells[0].lstrip("# ") for _, cells in rows if cells[0].startswith("#")]
    rows = [(line, cells) for line, cells in rows if not cells[0].startswith("#")]
    if not rows:
        raise FileError(f"{path}: its first sheet is empty.", file=str(path))
    width = max(k + 1 for k, cell in enumerate(rows[0][1]) if cell)
    return Sheet(path, rows[0][1][:width], [(line, cells[:width]) for line, cells in rows[1:]], comments)


def _text(cell: object) -> str:
    if cell is None:
        return ""
    return repr(cell) if isinstance(cell, float) else str(cell).strip()


def _refuse_large(path: Path) -> None:
    try:
        size = unpacked_bytes(path)
    except ValueError as error:
        raise FileError(f"{path}: is not an XLSX workbook ({error}).", file=str(path)) from error
    if size > MAX_BYTES:
        raise FileError(
            f"{path}: unpacks to {size / 1e6:.0f} MB; a robot's table is small. Save the one sheet by itself.",
            file=str(path),
        )


# quantity -> its spellings in tables
QUANTITIES = {
    "theta_offset": ("theta_offset", "theta", "offset"),
    "d": ("d",),
    "a": ("a", "r"),
    "alpha": ("alpha",),
    "beta": ("beta",),
    "lower": ("lower", "min"),
    "upper": ("upper", "max"),
}
ANGLES = {"deg": 1.0, "rad": 180.0 / math.pi}
TEXTS = ("joint", "type")
KINDS = {"revolute": "revolute", "r": "revolute", "prismatic": "prismatic", "p": "prismatic", "": "revolute"}


def read_table(path: Path, convention: str | None, name: str) -> dict[str, Any]:
    """Return the robot document of a table with columns such as ``theta_offset_deg, d_mm, a_mm, alpha_deg``.

    Raises:
        FileError: an unknown column, one without a unit, or a cell that is not a number; the message names it.
        UsageError: neither the file nor ``convention`` says whether it is DH or MDH.
        MissingPackageError: XLSX without openpyxl.

    """
    sheet = read_workbook(path) if path.suffix.lower() == ".xlsx" else _read_csv(path)
    return _document(sheet, _convention(sheet, convention), name)


def _read_csv(path: Path) -> Sheet:
    lines = [(number, line) for number, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    comments = [line.lstrip("# ") for _, line in lines if line.startswith("#")]
    data = [(number, line) for number, line in lines if not line.startswith("#")]
    if not data:
        raise FileError(f"{path}: has no rows.", file=str(path))
    delimiter = max(";\t,", key=data[0][1].count)
    cells = [
        (number, [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]) for number, line in data
    ]
    return Sheet(path, cells[0][1], cells[1:], comments, "," if delimiter != "," else ".")


def _convention(sheet: Sheet, given: str | None) -> str:
    said = next((m[1] for c in sheet.comments if (m := re.match(r"kilter (dh|mdh) table", c))), None)
    if given and said and given != said:
        raise UsageError(f"{sheet.path.name} says that it is a {said} table, not {given}.")
    found = given or said
    if found is None:
        raise UsageError(
            f"{sheet.path.name}: is this a dh or an mdh (Craig) table? They have the same columns but another geometry: "
            "give --convention dh or --convention mdh."
        )
    if found not in ("dh", "mdh"):
        raise UsageError(f"--convention is {found!r}: give dh or mdh.")
    return found


def _document(sheet: Sheet, convention: str, name: str) -> dict[str, Any]:
    columns = _columns(sheet, convention)
    if not sheet.rows:
        raise FileError(f"{sheet.path}: has no rows below its header.", file=str(sheet.path))
    rows, joints = [], []
    weights: list[tuple[int, Cells]] = []
    for number, (line, cells) in enumerate(sheet.rows, 1):
        if len(cells) != len(sheet.names):
            message = f"{len(cells)} cells where the header has {len(sheet.names)}."
            raise FileError(f"{sheet.path}, line {line}: {message}", file=str(sheet.path), line=line)
        row, joint = _row(sheet, columns, line, cells)
        rows.append(row)
        weights.append((line, _weights(sheet, columns, line, cells)))
        joints.append({"name": joint.pop("name", None) or f"j{number}", **joint})
    document: dict[str, Any] = {"name": name, "convention": convention, "joints": joints, "rows": rows}
    document |= {key: frame for key in ("base", "tool") if (frame := _frame(sheet, key))}
    more = {"links": links(sheet, weights), "gravity_m_s2": _gravity(sheet), "load": _load(sheet)}
    return document | {key: value for key, value in more.items() if value}


def _columns(sheet: Sheet, convention: str) -> list[tuple[str, str]]:
    """Return (quantity, unit) of every column; unit "" for texts."""
    spellings = {spelling: quantity for quantity, names in QUANTITIES.items() for spelling in names}
    out = []
    for name in sheet.names:
        plain = plain_name(name)
        quantity, _, unit = plain.rpartition("_")
        if plain in TEXTS:
            out.append((plain, ""))
        elif weight := mass_column(plain):
            out.append(weight)
        elif spellings.get(quantity) and unit in (*LENGTHS, *ANGLES):
            out.append((spellings[quantity], unit))
        else:
            raise _unknown(sheet, name, plain in (*spellings, *MASS_QUANTITIES))
    refuse_half_a_group(sheet, {quantity for quantity, _ in out})
    if convention == "dh" and any(quantity == "beta" for quantity, _ in out):
        raise FileError(
            f"{sheet.path}: a dh table has no beta; use --convention mdh.", file=str(sheet.path), column="beta"
        )
    return out


def _unknown(sheet: Sheet, name: str, lacks_unit: bool) -> FileError:
    known = [f"{quantity}_{'mm' if quantity in 'da' else 'deg'}" for quantity in QUANTITIES]
    known += [*TEXTS, *NAMES]
    why = "has no unit: write it as, for example, alpha_deg or a_mm" if lacks_unit else "is not known"
    return FileError(
        f"{sheet.path}, column {name!r} {why}{did_you_mean(name, known)}. Known are {', '.join(known)} "
        "(also with _rad and _m).",
        file=str(sheet.path),
        column=name,
    )


def _row(
    sheet: Sheet, columns: list[tuple[str, str]], line: int, cells: list[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    texts = {quantity: cell for (quantity, unit), cell in zip(columns, cells, strict=True) if not unit}
    kind = KINDS.get(texts.get("type", "").lower())
    if kind is None:
        message = f"type {texts['type']!r} is neither revolute nor prismatic."
        raise FileError(f"{sheet.path}, line {line}: {message}", file=str(sheet.path), line=line, column="type")
    row: dict[str, Any] = {"type": kind}
    limits: dict[str, float] = {}
    for (quantity, unit), cell in zip(columns, cells, strict=True):
        if not unit or quantity in MASS_QUANTITIES or (not cell and quantity not in ("d", "beta")):
            continue
        factor, word = _factor(sheet, quantity, unit, kind)
        if factor is None:
            raise FileError(
                f"{sheet.path}, line {line}: {quantity} of a {kind} joint cannot be in {unit}.",
                file=str(sheet.path),
                line=line,
                column=quantity,
            )
        value = None if not cell else _number(sheet, line, quantity, cell) * factor
        if quantity in ("lower", "upper"):
            limits[quantity] = value or 0.0
        else:
            row[f"{quantity}_{word}"] = value
    # Before what a spreadsheet would compute, an exporter writes an apostrophe, which does not belong to the name.
    joint: dict[str, Any] = {"name": (texts.get("joint") or "").removeprefix("'") or None}
    if len(limits) == 2:
        joint["limits_mm" if kind == "prismatic" else "limits_deg"] = [limits["lower"], limits["upper"]]
    return row, joint


def _weights(sheet: Sheet, columns: list[tuple[str, str]], line: int, cells: list[str]) -> dict[str, float | None]:
    """Return the cells about masses: kg, mm and kg m2; None where a cell is empty."""
    return {
        quantity: _number(sheet, line, quantity, cell) * LENGTHS.get(unit, 1.0) if cell else None
        for (quantity, unit), cell in zip(columns, cells, strict=True)
        if quantity in MASS_QUANTITIES
    }


def _factor(sheet: Sheet, quantity: str, unit: str, kind: str) -> tuple[float | None, str]:
    """Return the factor to mm or degrees, None when the unit is of the other sort."""
    length = quantity in ("d", "a") or (quantity in ("lower", "upper") and kind == "prismatic")
    return (LENGTHS.get(unit), "mm") if length else (ANGLES.get(unit), "deg")


def _number(sheet: Sheet, line: int, column: str, cell: str) -> float:
    try:
        value = float(cell.replace(sheet.decimal, "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileError(
            f"{sheet.path}, line {line}, {column}: {cell!r} is not a number.",
            file=str(sheet.path),
            line=line,
            column=column,
        )
    return value


def _frame(sheet: Sheet, key: str) -> dict[str, float]:
    """Return base or tool from a comment such as ``# tool x_mm=0 ... rz_deg=90``."""
    return _numbers_in_comments(sheet, key, r"[xyz]_mm|r[xyz]_deg")


def _gravity(sheet: Sheet) -> list[float]:
    """Return gravity in the base frame from ``# gravity x_m_s2=0 y_m_s2=0 z_m_s2=-9.80665``; empty where nothing is said."""
    said = _numbers_in_comments(sheet, "gravity", "[xyz]_m_s2")
    return [said.get(f"{axis}_m_s2", 0.0) for axis in "xyz"] if said else []


def _load(sheet: Sheet) -> dict[str, Any]:
    """Return the default load from ``# load payload_kg=2.5 x_mm=0 y_mm=0 z_mm=60``; empty where nothing is said."""
    said = _numbers_in_comments(sheet, "load", "payload_kg|[xyz]_mm")
    if "payload_kg" not in said:
        return {}
    return {"payload_kg": said["payload_kg"], "payload_com_mm": [said.get(f"{axis}_mm", 0.0) for axis in "xyz"]}


def _numbers_in_comments(sheet: Sheet, key: str, names: str) -> dict[str, float]:
    for comment in sheet.comments:
        word, _, rest = comment.partition(" ")
        if word == key:
            pairs = re.findall(rf"({names})=(\S+)", rest)
            return {name: _number(sheet, 0, f"{key} {name}", value) for name, value in pairs}
    return {}
