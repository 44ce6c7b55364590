"""What the server would refuse in a file, as far as this is known before anything is sent."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from kilter_files.ground.errors import MissingPackageError
from kilter_files.ground.later import need, pa, parquet
from kilter_files.ground.time_stamps import clusters
from kilter_files.ground.units import column_unit, converter
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, Prepared

Document = dict[str, Any]
Columns = dict[str, list[float]]

NEAR_DEG = math.degrees(1e-4)  # as the server: joints that agree within 0.1 mrad (0.1 mm) are one pose
NEAR_MM = 0.1
SHOWN_IN = {"rad": "deg", "m": "mm", "rad/s": "deg/s", "m/s": "mm/s", "rad/s2": "deg/s2", "m/s2": "mm/s2"}
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


LIMIT_TOLERANCE = {"deg": 10.0, "mm": 20.0}  # the server's, which warns about less: see docs/reference/columns.md
JOINT = re.compile(r"q(\d+)_(?:deg|rad|mm|m)")
NAMES = ("camera", "board")  # a cell may hold a name for its number
SEEN = re.compile(r"(?:m\d+[xyz]|tip[xyz])_(?:mm|m)|s?[uv]\d+_px|tilt\d+[xyz]_(?:deg|rad)")  # in some rows only
PLACE = re.compile(r"[xyz]_(?:mm|m)|q[wxyz]|(?:phi|theta|psi)_(?:deg|rad)")
LINK = re.compile(r"link\d+_(?:deg|rad|mm|m)")
KINDS = (
    PLACE,
    LINK,
    *map(re.compile, (r"m\d+x_(?:mm|m)", r"u\d+_px", r"tilt\d+[xyz]_(?:deg|rad)")),
)  # beside each other
SHOWN = 5


def otherwise_separated(prepared: Prepared) -> list[str]:
    """What is wrong with a CSV of contract columns whose cells are not separated by commas: nothing else is known of it."""
    head = prepared.content.split(b"\n", 1)[0]
    if prepared.content_type != CSV_TYPE or not (b";" in head or b"\t" in head):
        return []
    return [
        "its columns are separated by ';' or tabs: kilter measure inspect FILE --draft columns.toml writes a map for --map"
    ]


def refusals(columns: Columns, joints: Sequence[Mapping[str, Any]] | None, lines: Sequence[int] = ()) -> list[str]:
    """Name every rule that is broken, with rows; ``joints`` are those of the robot as the server knows it."""
    beside = sum(any(map(kind.fullmatch, columns)) for kind in KINDS) > 1
    found = [
        f"{name} is empty or not a number {_in_rows([math.isnan(v) for v in values], lines)}"
        for name, values in columns.items()
        if not _may_be_empty(name, beside) and any(math.isnan(v) for v in values)
    ]
    if joints is None:
        return found
    numbers = {int(match[1]): name for name in columns if (match := JOINT.fullmatch(name))}
    if sorted(numbers) != list(range(1, len(joints) + 1)):
        found.append(f"the file has joints {', '.join(map(str, sorted(numbers))) or 'none'}, the robot {len(joints)}")
    for number, joint in enumerate(joints, 1):
        if number in numbers:
            found += _outside(numbers[number], columns[numbers[number]], joint, lines)
    return found


def _may_be_empty(name: str, beside: bool) -> bool:
    """Whether a cell may be missing, or not be a number; ``beside`` says that other rows were measured otherwise."""
    if SEEN.fullmatch(name) or name in NAMES:
        return True
    return beside and bool(PLACE.fullmatch(name) or LINK.fullmatch(name))


def _outside(name: str, values: list[float], joint: Mapping[str, Any], lines: Sequence[int]) -> list[str]:
    unit, shown = in_shown_unit(name, values)
    low, high = joint.get(f"limits_{unit}") or (None, None)
    low, high = -math.inf if low is None else low, math.inf if high is None else high
    beyond = [max(low - v, v - high, 0.0) for v in shown]
    wrong = [size > LIMIT_TOLERANCE[unit] for size in beyond]
    if not any(wrong):
        return []
    where = f"limits {low:.6g} to {high:.6g} {unit} of {joint['name']}"
    return [f"{name} is outside the {where} {_in_rows(wrong, lines)}, by up to {max(beyond):.3g} {unit}"]


def _in_rows(wrong: Sequence[bool], lines: Sequence[int]) -> str:
    rows = [k for k, is_wrong in enumerate(wrong) if is_wrong]
    where = [lines[k] if k < len(lines) else k + 1 for k in rows[:SHOWN]]
    word = "line" if lines else "row"
    more = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
    return f"in {len(rows)} rows ({word} {', '.join(map(str, where))}{more})"


# Parameters of effects that physics keeps above 0; those by the load say what to check.
BY_LOAD = re.compile(
    r"(backlash_load|compliance|bending|gravity_spring|hardening|strain_wave_\d+|radial_compliance|telescope|torsion)_\d+"
    r"|(base_compliance|clearance)_\w+|sag_per_kg"
)
NEVER_NEGATIVE = re.compile(rf"{BY_LOAD.pattern}|(lag|link_expansion)_\d+|expansion")
WITHIN_95 = 1.96  # standard deviations


def below_zero(name: str, value: float | None) -> bool:
    """Whether a parameter that cannot be negative is."""
    return value is not None and value < 0.0 and NEVER_NEGATIVE.fullmatch(name) is not None


def why_unusual(name: str, value: float | None, sigma: float | None) -> str:
    """Words for a value outside its physical range; ``value`` and ``sigma`` in one unit."""
    if value is None or not below_zero(name, value):
        return "outside its physical range: look for what is missing in the model"
    if sigma is not None and value + WITHIN_95 * sigma >= 0.0:
        return "not seen: below 0 by less than its uncertainty"
    check = "check masses, payload and how the base stands, or " if BY_LOAD.fullmatch(name) else ""
    return f"below 0, which cannot be: {check}look for what is missing in the model"
