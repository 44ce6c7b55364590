"""Ball bars, inclinometers and points joined with the joint log.

Both go along the same circle. Each run of the bar belongs to one pass of the log, in order; within it the angle says
which joints a reading was taken at.
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
from numpy.typing import NDArray

from kilter_files.formats.instrument_logs import BallBar, read_inclinometer, tilt_column_indices
from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.marker_header import PRESETS
from kilter_files.formats.reader import Hints, LogHints
from kilter_files.formats.registry import all_readers
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, UsageError, fault
from kilter_files.ground.text_layout import sniff
from kilter_files.ground.units import JOINT, SIZES
from kilter_files.match.dwells import RestOptions
from kilter_files.match.matching import Columns, match_dwells, pose_numbers, pose_row_indices
from kilter_files.rig.drawn_circle import commanded_mm, refuse_other_length
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


NEAR_MM = 1.5  # rows of the log farther from the circle are the way to it
SAME_FOOT_MM = 0.5
SHORTEST_PASS_DEG = 20.0
TOLERANCE_DEG = 1.0
UPRIGHT = 0.1


@dataclass(frozen=True)
class Pass:
    """One pass: rows of the log, their angle in degrees, which only rises or only falls, and the centre mount's place."""

    rows: NDArray[np.int64]
    angle_deg: Floats
    centre_mm: Floats
    radius_mm: float

    @property
    def direction(self) -> str:
        """Counterclockwise or clockwise, seen from above."""
        return "ccw" if self.angle_deg[-1] > self.angle_deg[0] else "cw"


def join_ballbar(bar: BallBar, log: JointLog, zero_deg: float = 0.0) -> tuple[Table, dict[str, Any]]:
    """Join: one row per reading; ``zero_deg`` is where the bar's angle 0 lies, counted from the robot's x axis.

    Raises:
        FileError: a log that goes along no circle, or not along the bar's, or along a circle of another radius.

    """
    passes = find_circle_passes(log)
    runs = [np.flatnonzero(bar.run == run) for run in np.unique(bar.run)]
    ways = ["ccw" if np.median(np.diff(bar.angle_deg[run])) > 0 else "cw" for run in runs]
    if ways != [way.direction for way in passes]:
        what = f"has {len(runs)} runs ({', '.join(ways)}), {log.path.name} goes round {len(passes)} times"
        said = ", ".join(way.direction for way in passes)
        raise fault(bar.path, f"{what} ({said or 'never'})", "Give the log of the same runs, in the same order.")
    for way in passes:
        refuse_other_length(bar.path, bar.nominal_mm, way.radius_mm)
    columns: dict[str, list[float]] = {name: [] for name in (*log.joints, "bar_id", "bar_mm")}
    feet: list[Floats] = []
    lines: list[int] = []
    for run, way in zip(runs, passes, strict=True):
        angle = _unwrap_to_pass(bar, bar.angle_deg[run] + zero_deg, way, zero_deg)
        order = np.argsort(way.angle_deg)
        for name in log.joints:
            values = log.columns[name][way.rows]
            columns[name] += [float(v) for v in np.interp(angle, way.angle_deg[order], values[order])]
        columns["bar_id"] += [float(_foot(feet, way.centre_mm))] * len(run)
        columns["bar_mm"] += [round(float(v), 6) for v in bar.radius_mm[run]]
        lines += [int(line) for line in bar.line[run]]
    table = Table(columns, lines, list(bar.notes), list(bar.warnings))
    table.notes.append(f"{len(runs)} runs about {len(feet)} centre mounts have their joints from {log.path.name}")
    return table, {"rows": len(lines), "runs": len(runs), "feet": len(feet), "radius_mm": round(passes[0].radius_mm, 4)}


def find_circle_passes(log: JointLog) -> list[Pass]:
    """Find every way round a circle that is seen from above; feed-in along the circle belongs to it.

    Raises:
        FileError: no commanded positions, or no circle among them.

    """
    p = commanded_mm(log)
    out = []
    for part in _on_circles(p):
        centre, axes, radius = _circle(p[part])
        local = (p[part] - centre) @ axes
        angle = np.degrees(np.unwrap(np.arctan2(local[:, 1], local[:, 0])))
        out += [Pass(part[piece], angle[piece], centre, radius) for piece in _monotone(angle)]
    if not out:
        raise fault(log.path, "goes along no circle", "Give the log of the ball bar's runs, with x_mm, y_mm, z_mm.")
    return out


def _on_circles(p: Floats) -> list[NDArray[np.int64]]:
    """Stretches of rows that lie on one circle each: neighbours whose curvature and plane agree."""
    out: list[NDArray[np.int64]] = []
    left = np.arange(len(p))
    while len(left) >= 8:
        best = max(
            (_grown(p, left, k) for k in range(0, len(left), max(1, len(left) // 12))), key=len, default=left[:0]
        )
        if len(best) < 8:
            break
        out.append(best)
        left = np.setdiff1d(left, np.arange(best[0], best[-1] + 1))
    return sorted(out, key=lambda rows: int(rows[0]))


def _grown(p: Floats, left: NDArray[np.int64], at: int) -> NDArray[np.int64]:
    """Rows of ``left`` around ``at``, without a gap, near the circle through the ones next to it."""
    near = left[max(0, at - len(left) // 24 - 4) : at + len(left) // 24 + 4]
    if len(near) < 6:
        return left[:0]
    found = near
    for _ in range(3):
        centre, axes, radius = _circle(p[found])
        local = (p - centre) @ axes
        on = (np.abs(np.hypot(local[:, 0], local[:, 1]) - radius) < NEAR_MM) & (np.abs(local[:, 2]) < NEAR_MM)
        on &= np.isin(np.arange(len(p)), left) & (radius < 1e4)
        if not on[near].all():
            return left[:0]
        first, last = int(near[0]), int(near[-1])
        while first > 0 and on[first - 1]:
            first -= 1
        while last < len(p) - 1 and on[last + 1]:
            last += 1
        found = np.arange(first, last + 1)
    return found


def _circle(p: Floats) -> tuple[Floats, Floats, float]:
    """Centre, axes (x along the robot's, z up) and radius of the circle that fits the points best."""
    middle = p.mean(axis=0)
    normal = np.linalg.svd(p - middle, full_matrices=False)[2][2]
    # Up; of a circle that stands upright, along the robot's y or x.
    main = next((k for k in (2, 1, 0) if abs(normal[k]) > UPRIGHT), 2)
    normal = normal if normal[main] > 0 else -normal
    x = np.eye(3)[0] if abs(normal[0]) < 0.9 else np.eye(3)[1]
    x = x - normal * (x @ normal)
    axes = np.stack([x / np.linalg.norm(x), np.cross(normal, x / np.linalg.norm(x)), normal], axis=1)
    flat = ((p - middle) @ axes)[:, :2]
    a, b, c = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(p))]), (flat**2).sum(axis=1), rcond=None)[0]
    return middle + axes[:, :2] @ [a, b], axes, float(np.sqrt(max(c + a * a + b * b, 0.0)))


def _monotone(angle: Floats) -> list[NDArray[np.int64]]:
    """Stretches in which the angle only rises or only falls, rests left out."""
    step = np.diff(angle)
    moving = np.flatnonzero(np.abs(step) > 1e-6)
    out = []
    for piece in np.split(moving, np.flatnonzero(np.diff(np.sign(step[moving])) != 0) + 1):
        if len(piece):
            rows = np.append(piece, piece[-1] + 1)
            if abs(angle[rows[-1]] - angle[rows[0]]) > SHORTEST_PASS_DEG:
                out.append(rows)
    return out


def _unwrap_to_pass(bar: BallBar, angle: Floats, way: Pass, zero_deg: float) -> Floats:
    """Angles of a run, whole turns added so that the log's pass covers them."""
    angle = np.degrees(np.unwrap(np.radians(angle)))
    low, high = way.angle_deg.min() - TOLERANCE_DEG, way.angle_deg.max() + TOLERANCE_DEG
    turns = [k for k in range(-4, 5) if angle.min() + 360 * k >= low and angle.max() + 360 * k <= high]
    if len(turns) != 1:
        there = f"from {way.angle_deg[0] % 360:.1f} deg over {np.ptp(way.angle_deg):.1f} deg"
        what = f"a run begins at {angle[0] % 360:.1f} deg and covers {np.ptp(angle):.1f} deg, the log goes {there}"
        other = (zero_deg + way.angle_deg[0] - angle[0]) % 360
        remedy = f"If the bar's angle 0 is not the robot's x axis, give where it is (here --zero-deg {other:.1f})"
        raise fault(bar.path, what, remedy + "; or give the log of these runs alone.")
    return np.asarray(angle + 360 * turns[0])


def _foot(feet: list[Floats], centre: Floats) -> int:
    for k, known in enumerate(feet, 1):
        if np.linalg.norm(known - centre) < SAME_FOOT_MM:
            return k
    feet.append(centre)
    return len(feet)
