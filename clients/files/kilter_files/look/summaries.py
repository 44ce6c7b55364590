"""What a prepared file holds, for a dry run: ranges in mm and deg, poses and their repeats, loads, directions."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from kilter_files.ground.clusters import clusters
from kilter_files.ground.errors import MissingPackageError
from kilter_files.ground.later import need, pa, parquet
from kilter_files.ground.units import column_unit, converter
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, Prepared

Document = dict[str, Any]
Columns = dict[str, list[float]]

NEAR_DEG = math.degrees(1e-4)  # as the server: joints that agree within 0.1 mrad (0.1 mm) are one pose
NEAR_MM = 0.1
SHOWN_IN = {"rad": "deg", "m": "mm", "rad/s": "deg/s", "m/s": "mm/s", "rad/s2": "deg/s2", "m/s2": "mm/s2"}
JOINT = re.compile(r"q\d+_(?:deg|rad|mm|m)")
DIRECTION = re.compile(r"dir(\d+)")
CENTRE = ("payload_com_x_mm", "payload_com_y_mm", "payload_com_z_mm")
LOADS = ("payload_kg", *CENTRE, "fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
CONDITIONS = ("payload_kg", "payload_com_mm", "tool_force_n", "tool_moment_nm")
MOST_LOADS = 12


def summary(prepared: Prepared, conditions: Mapping[str, Any]) -> Document:
    """Summarise what would be sent; ``conditions`` are those of the whole campaign."""
    columns = numeric_columns(prepared)
    if not columns:
        return {}
    rows = max(map(len, columns.values()))
    return {
        "rows": rows,
        "ranges": [_range(name, values) for name, values in columns.items()],
        "poses": _poses(columns, rows),
        "loads": _loads(columns, conditions),
        "directions": {
            name: {sign: values.count(float(sign)) for sign in ("-1", "0", "1")}
            for name, values in columns.items()
            if DIRECTION.fullmatch(name)
        },
    }


def numeric_columns(prepared: Prepared) -> Columns:
    """Return every column as numbers, NaN where a cell is empty or not a number; nothing where the bytes are not understood."""
    if prepared.content_type == CSV_TYPE:
        return _csv(prepared.content)
    if prepared.content_type == JSON_TYPE:
        try:
            found = json.loads(prepared.content)
        except ValueError:
            return {}
        lists = {str(name): values for name, values in found.items()} if isinstance(found, dict) else {}
        return {name: [_number(v) for v in values] for name, values in lists.items() if isinstance(values, list)}
    return _parquet(prepared.content)


def in_shown_unit(name: str, values: Sequence[float]) -> tuple[str, list[float]]:
    """Return the unit people read, mm and deg for m and rad, and the values in it."""
    unit = column_unit(name) or ""
    shown = SHOWN_IN.get(unit, unit)
    convert = converter(unit, shown)
    return shown, list(values) if convert is None else [convert(value) for value in values]


def _range(name: str, values: list[float]) -> Document:
    unit, shown = in_shown_unit(name, values)
    known = [value for value in shown if not math.isnan(value)]
    low, high = (min(known), max(known)) if known else (None, None)
    return {"name": name, "unit": unit, "low": low, "high": high, "empty": len(values) - len(known)}


def _poses(columns: Columns, rows: int) -> Document | None:
    """Number of poses, rows of each, and visits: rows that follow each other under the same conditions are one."""
    numbered = [columns["pose_id"]] if "pose_id" in columns else _same_joints(columns)
    if not numbered or any(len(values) != rows for values in numbered):
        return None
    poses = list(zip(*numbered, strict=True))
    beside = [
        v for name, v in columns.items() if name in ("payload_kg", *CENTRE, "session") or DIRECTION.fullmatch(name)
    ]
    under = list(zip(*numbered, *beside, strict=True))
    visits = Counter(pose for k, pose in enumerate(poses) if k == 0 or under[k] != under[k - 1])
    each = Counter(poses)
    return {
        "count": len(each),
        "by": "pose_id" if "pose_id" in columns else "equal joints",
        "rows_per_pose": [min(each.values()), max(each.values())],
        "visits_per_pose": [min(visits.values()), max(visits.values())],
        "repeated": sum(count > 1 for count in visits.values()),
    }


def _same_joints(columns: Columns) -> list[list[float]]:
    out = []
    for name, values in columns.items():
        if JOINT.fullmatch(name):
            unit, shown = in_shown_unit(name, values)
            out.append([float(k) for k in clusters(shown, NEAR_DEG if unit == "deg" else NEAR_MM)])
    return out


def _loads(columns: Columns, conditions: Mapping[str, Any]) -> Document:
    """Distinct loads of the rows, else that of the campaign."""
    out: Document = {}
    for name in LOADS:
        if name in columns:
            values = sorted({value for value in columns[name] if not math.isnan(value)})
            out[name] = values if len(values) <= MOST_LOADS else [values[0], values[-1]]
            if len(values) > MOST_LOADS:
                out[f"{name}_distinct"] = len(values)
    told = {key: value for key, value in conditions.items() if key in CONDITIONS}
    return out | {f"campaign_{key}": value for key, value in told.items() if value is not None}


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _cell(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _csv(content: bytes) -> Columns:
    try:
        rows = [row for row in csv.reader(io.StringIO(content.decode("utf-8-sig"), newline="")) if row]
    except (UnicodeDecodeError, csv.Error):
        return {}
    names = [name.strip() for name in rows[0]] if rows else []
    if any(len(row) != len(names) for row in rows):
        return {}
    return {name: [_cell(row[k]) for row in rows[1:]] for k, name in enumerate(names)} if len(rows) > 1 else {}


def _parquet(content: bytes) -> Columns:
    try:
        need("Parquet files need", "pyarrow")
    except MissingPackageError:
        return {}
    try:
        table = parquet.read_table(io.BytesIO(content))
    except (pa.ArrowException, OSError):
        return {}
    return {name: [_number(v) for v in table.column(name).to_pylist()] for name in table.column_names}
