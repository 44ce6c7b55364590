"""DH and MDH tables, one row per joint, from CSV and XLSX."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import Any

from kilter_files.ground.archives import unpacked_bytes
from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import need
from kilter_files.ground.names import did_you_mean
from kilter_files.ground.workbook_formulas import REMEDY, describe_cells, formulas_without_value
from kilter_files.robots import masses
from kilter_files.robots.masses import Sheet
from kilter_files.robots.text import read_text

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
LENGTHS = {"mm": 1.0, "m": 1e3}
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
    weights: list[tuple[int, masses.Cells]] = []
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
    more = {"links": masses.links(sheet, weights), "gravity_m_s2": _gravity(sheet), "load": _load(sheet)}
    return document | {key: value for key, value in more.items() if value}


def _columns(sheet: Sheet, convention: str) -> list[tuple[str, str]]:
    """Return (quantity, unit) of every column; unit "" for texts."""
    spellings = {spelling: quantity for quantity, names in QUANTITIES.items() for spelling in names}
    out = []
    for name in sheet.names:
        plain = masses.plain_name(name)
        quantity, _, unit = plain.rpartition("_")
        if plain in TEXTS:
            out.append((plain, ""))
        elif weight := masses.mass_column(plain):
            out.append(weight)
        elif spellings.get(quantity) and unit in (*LENGTHS, *ANGLES):
            out.append((spellings[quantity], unit))
        else:
            raise _unknown(sheet, name, plain in (*spellings, *masses.QUANTITIES))
    masses.refuse_half_a_group(sheet, {quantity for quantity, _ in out})
    if convention == "dh" and any(quantity == "beta" for quantity, _ in out):
        raise FileError(
            f"{sheet.path}: a dh table has no beta; use --convention mdh.", file=str(sheet.path), column="beta"
        )
    return out


def _unknown(sheet: Sheet, name: str, lacks_unit: bool) -> FileError:
    known = [f"{quantity}_{'mm' if quantity in 'da' else 'deg'}" for quantity in QUANTITIES]
    known += [*TEXTS, *masses.NAMES]
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
        if not unit or quantity in masses.QUANTITIES or (not cell and quantity not in ("d", "beta")):
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
        if quantity in masses.QUANTITIES
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
