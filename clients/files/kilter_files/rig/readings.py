"""Readings of inclinometers at joints, a row each, as ``kilter measure joint-parameters --propose`` writes them."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import fault

TO_DEG: Mapping[str, float] = {"deg": 1.0, "mrad": 180.0 / math.pi / 1000.0, "arcmin": 1.0 / 60.0}
JOINT_VALUE = re.compile(r"^q(\d+)_(deg|mm)$")
CENTRE = ("payload_com_x_mm", "payload_com_y_mm", "payload_com_z_mm")
OTHERS = ("joint", "axis", "payload_kg", *CENTRE, "series")


def read_readings(path: Path) -> list[dict[str, Any]]:
    """Readings for a ``joint_parameters`` job.

    Columns: ``joint``, ``axis`` (x, y or z), ``q1_deg`` ... (``_mm`` if prismatic), ``reading_deg`` (or ``_mrad``,
    ``_arcmin``), optional ``payload_kg``, ``payload_com_x_mm`` ... and ``series``. Lines that start with # are notes.

    Raises:
        FileError: a column that is missing or unknown, or a cell that is not a number; names line and column.

    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise fault(path, "cannot be read as text", "Save it as CSV in UTF-8.") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    if len(lines) < 2:
        raise fault(path, "it holds no readings", "Give a line of column names and a line for each reading.")
    names = [name.strip() for name in next(csv.reader([lines[0][1]]))]
    joints, reading = _columns(path, names, lines[0][0])
    return [_reading(path, number, names, next(csv.reader([line])), joints, reading) for number, line in lines[1:]]


def _columns(path: Path, names: Sequence[str], line: int) -> tuple[list[str], str]:
    """Joint columns in order, and the column of the reading."""
    places = {int(m[1]): name for name in names if (m := JOINT_VALUE.match(name))}
    readings = [name for name in names if name.startswith("reading_") and name[8:] in TO_DEG]
    known = {*OTHERS, *places.values(), *readings}
    for name in names:
        if name not in known:
            remedy = (
                "There are joint, axis, q1_deg (q1_mm) ..., payload_kg, payload_com_x_mm ..., series, and reading_ in "
                f"{', '.join(TO_DEG)}."
            )
            raise fault(path, "an unknown column", remedy, line=line, column=name)
    for name, there in (("joint", "joint" in names), ("axis", "axis" in names), ("reading_deg", len(readings) == 1)):
        if not there:
            raise fault(path, f"the column {name} is missing or there twice", "Name it so.", line=line)
    if sorted(places) != list(range(1, len(places) + 1)) or not places:
        raise fault(
            path, "the joint values are not q1 to qn", "Give every joint, as q1_deg (prismatic: q1_mm).", line=line
        )
    return [places[k] for k in sorted(places)], readings[0]


def _reading(
    path: Path, line: int, names: Sequence[str], cells: Sequence[str], joints: Sequence[str], reading: str
) -> dict[str, Any]:
    if len(cells) != len(names):
        raise fault(path, f"{len(cells)} cells under {len(names)} columns", "Complete the row.", line=line)
    row = {name: cell.strip() for name, cell in zip(names, cells, strict=True)}
    if not row[reading]:
        raise fault(path, "there is no reading", "Fill it in, or delete the row.", line=line, column=reading)

    def value(name: str) -> float:
        try:
            number = float(row[name])
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise fault(path, f"{row[name]!r} is not a number", "Correct the cell.", line=line, column=name)
        return number

    out: dict[str, Any] = {"joint": row["joint"], "axis": row["axis"].lower(), "q_deg": [value(q) for q in joints]}
    out["reading_deg"] = value(reading) * TO_DEG[reading[8:]]
    if row.get("payload_kg"):
        out["payload_kg"] = value("payload_kg")
    if any(row.get(name) for name in CENTRE):
        out["payload_com_mm"] = [value(name) for name in CENTRE]
    if row.get("series"):
        out["series"] = round(value("series"))
    return out
