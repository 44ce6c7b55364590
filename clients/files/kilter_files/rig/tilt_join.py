"""Inclinometer logs joined with the joint log: dwells are found and averaged as those of a tracker, and become readings.

Points of a tracker or CMM with the joints of another file, row by row, as rows.

Readings of inclinometers at joints, a row each, as ``kilter measure joint-parameters --propose`` writes them.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.logs.ballbar import read_inclinometer, tilt_column_indices
from kilter_files.formats.reader import Hints, LogHints
from kilter_files.formats.recordings.marker_header import PRESETS
from kilter_files.formats.registry import all_readers
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, UsageError, fault
from kilter_files.ground.text_layout import sniff
from kilter_files.ground.units import JOINT, SIZES
from kilter_files.match.dwells import RestOptions
from kilter_files.match.matching import Columns, match_dwells, pose_numbers, pose_row_indices
from kilter_files.tables.recording import Block, Recording
from kilter_files.tables.table import JointLog, Table

ARM_MM = 1000.0  # the tip of a pointer so long stands for an angle: 1 mm/s is 0.06 deg/s
ROW = "log_row"
UNIT_TOLERANCE = 0.05
TURNED_DEG = 2.0  # of a joint, from which its motion tells the unit of the angles
STILL_DEG = 0.02


@dataclass(frozen=True)
class TiltOptions:
    """``joint`` is the number (from 1) the inclinometer sits behind, ``axis`` that of its frame; ``by`` order or time."""

    joint: int
    axis: str = "z"
    by: str = "time"
    channel: str = "x"
    unit: str | None = None
    rest: RestOptions = field(default_factory=RestOptions)


def pointer(path: Path, channel: str, unit: str | None) -> Recording:
    """Read an inclinometer log as a recording of one marker: the tip of a pointer that tilts.

    Raises:
        FileError: no such channel, or whatever ``read_inclinometer`` refuses.

    """
    found = read_inclinometer(path, unit)
    angle = found.columns.get(f"tilt_{channel}_deg")
    if angle is None:
        raise fault(path, f"has no inclination {channel}", "Choose the other with --channel.")
    t, a = found.columns["t_s"], np.radians(angle)
    steps = np.diff(t)
    if not (steps > 0).any():
        raise fault(path, "its time stands still", "Record more than one reading.")
    points = ARM_MM * np.stack([np.sin(a), np.cos(a), np.zeros(len(a))], axis=1)[:, None, :]

    def blocks() -> Iterator[Block]:
        yield Block(t.copy(), points.copy(), np.arange(1, len(t) + 1))

    rate = float(1.0 / np.median(steps[steps > 0]))
    return Recording(path, "inclinometer", ("pointer",), rate, len(t), blocks, found.notes, found.warnings)


def join_tilts(
    after: Path, before: Path | None, log: JointLog, joints: Sequence[str], options: TiltOptions
) -> tuple[dict[str, Floats], dict[str, Any]]:
    """Readings of one joint: configuration (``q1_deg`` ...) and ``reading_deg`` of every rest, and how they were found.

    ``joints`` are the robot's names of the joints. A reading is the inclination after the joint, minus that before it,
    minus the commanded rotation where the axis is the joint's own.

    Raises:
        FileError: rests that do not fit the log, angles in another unit than stated, an earlier joint that moves unseen.

    """
    marked = replace(log, columns=log.columns | {ROW: np.arange(len(log), dtype=np.float64)})
    rows, tilt, report = _rests(after, marked, options)
    if before is not None:
        others, level, more = _rests(before, marked, options)
        both, first, second = np.intersect1d(rows, others, return_indices=True)
        rows, tilt = both, tilt[first] - level[second]
        report["warnings"] += more["warnings"]
    q = log.q_even()[rows]
    if before is None:
        _refuse_unseen(after, q, options, joints)
    if options.axis == "z":
        tilt = _beyond_command(after, q[:, options.joint - 1], tilt, options)
    if len(rows) < 2:
        raise fault(
            after, f"has {len(rows)} dwells in common with the log", "Record all of them with both instruments."
        )
    columns = {_degrees(name): q[:, k] for k, name in enumerate(log.joints)}
    report |= {"readings": len(rows), "joint": joints[options.joint - 1], "axis": options.axis}
    return columns | {"reading_deg": tilt}, report


def _degrees(name: str) -> str:
    stem, _, unit = name.partition("_")
    return f"{stem}_deg" if unit in ("deg", "rad") else f"{stem}_mm"


def _rests(path: Path, log: JointLog, options: TiltOptions) -> tuple[Floats, Floats, dict[str, Any]]:
    """Rows of the log at rest, the mean inclination there in degrees, and the report of the matching."""
    recording = pointer(path, options.channel, options.unit)
    found = match_dwells(recording, log, options.by, options.rest)
    x, y = (found.columns[f"m1{axis}_mm"] for axis in "xy")
    tilt = np.degrees(np.unwrap(np.arctan2(x, y)))
    report = {"dwells": found.report["dwells"], "clock": found.report["clock"], "warnings": found.report["warnings"]}
    return found.columns[ROW].astype(np.int64), tilt, report


def _refuse_unseen(path: Path, q: Floats, options: TiltOptions, joints: Sequence[str]) -> None:
    moving = [joints[k] for k in range(options.joint - 1) if len(q) and np.ptp(q[:, k]) > STILL_DEG]
    if moving:
        what = f"{', '.join(moving)} before {joints[options.joint - 1]} moves too, and one inclinometer measures all of them"
        raise fault(path, what, "Give the log of the inclinometer on the link before the joint (--before).")


def _beyond_command(path: Path, q: Floats, tilt: Floats, options: TiltOptions) -> Floats:
    """Inclination minus the commanded rotation; its sign is that of the mounting."""
    if not len(q) or np.ptp(q) < TURNED_DEG:
        what = f"the joint rotates by {np.ptp(q) if len(q) else 0.0:.3g} deg between the dwells"
        raise fault(path, what, f"Rotate it by more than {TURNED_DEG:g} deg, so that sign and unit can be seen.")
    slope = float(np.polyfit(q, tilt, 1)[0])
    if abs(abs(slope) - 1.0) > UNIT_TOLERANCE:
        raise _other_unit(path, slope, options.unit or stated_unit(path))
    return np.asarray(np.sign(slope) * tilt - q)


def _other_unit(path: Path, slope: float, stated: str) -> FileError:
    """Say which unit would make the inclination follow the joint; angles were brought to degrees as ``stated``."""
    size = SIZES["angle"][stated] / max(abs(slope), 1e-9)
    likely = [unit for unit, own in SIZES["angle"].items() if abs(own / size - 1.0) < UNIT_TOLERANCE]
    what = f"the inclination changes {abs(slope):.4g} times as much as the joint rotates"
    if likely:
        what += f": the angles are {likely[0]} declared as {stated}"
        return fault(path, what, f"Give the unit: --unit {likely[0]}.")
    return fault(path, what, "Is it another joint, another axis (--axis), or is its axis steep?")


def stated_unit(path: Path) -> str:
    """Return the unit a log states for its inclinations, deg where it states none."""
    layout = sniff(path)
    return next((layout.units[i] or "deg" for i in tilt_column_indices(layout).values()), "deg")


def read_points(path: Path, preset: str, euler: str | None, joints: Path | None, hints: LogHints | None) -> Table:
    """Read an export of points; its joints are its own, or those of the log ``joints``, row by row.

    Raises:
        FileError: the export or the log is not what it should be, or there are no joints at all.
        UsageError: a preset that there is not.

    """
    if preset not in PRESETS:
        raise UsageError(f"--preset {preset}: is not one of {', '.join(PRESETS)}.")
    log = None if joints is None else read_joint_log(joints, hints or LogHints())
    beside = None if log is None else joint_columns_at_rest(log)
    table: Table = all_readers()["tracker-text"].read(path, Hints(preset=preset, euler=euler, joints=beside))
    if not any(JOINT.fullmatch(name) for name in table.columns):
        remedy = "Name the file that holds them (--joints), or send the export with a column map (--map)."
        raise fault(path, "holds points, but no joints with a unit", remedy)
    if log is not None:
        table.notes += [f"joints from {log.path.name}, row by row", *log.notes]
        table.warnings += log.warnings
    return table


def joint_columns_at_rest(joints: JointLog) -> Columns:
    """Return the columns of a joint log that belong beside points: a row for each time the arm came to rest."""
    rows = pose_row_indices(joints)
    columns = {name: joints.columns[name][rows] for name in joints.joints}
    known = joints.columns["pose_id"][rows] if "pose_id" in joints.columns else pose_numbers(joints, rows)
    return columns | {"pose_id": known}


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
