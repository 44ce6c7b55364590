"""Logs of double ball bars and of inclinometers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_files.formats.marker_header import canonical_column_name
from kilter_files.formats.reader import Document, Head, column
from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import blocks, count_rows, cut_remark, line_number_of_row, numbered_lines
from kilter_files.ground.text_layout import UNITS, TextLayout, sniff
from kilter_files.ground.units import SIZES, column_unit, converter
from kilter_files.tables.table import Table

if TYPE_CHECKING:
    from numpy.typing import NDArray


ANGLE = re.compile(r"^(?:angle|winkel|theta|angularposition|ang)[a-z]*$")
RADIUS = re.compile(r"^(?:radius|ballbarlength|barlength|length|r)$")
DEVIATION = re.compile(r"^(?:deviation|radialdeviation|dev|error|radialerror|deltar|dr|abweichung)$")
NOMINAL = re.compile(
    r"(?:nominal|test|calibrated|programmed)?\s*(?:ballbar|bar)?\s*(?:radius|length)"
    r"\s*(?:[\[(]\s*(?P<before>[^\])]*)[\])])?\s*[:=;,\t ]\s*(?P<value>\d+(?:[.,]\d+)?)\s*(?P<after>[a-zµ]*)",
    re.IGNORECASE,
)
RUN = re.compile(r"\b(run|lauf|ccw|cw|clockwise|anticlockwise|counterclockwise)\b", re.IGNORECASE)
JOINT = re.compile(r"^q([1-9]\d?)$")
MOST_ROWS = 2_000_000
LONGEST_LINE = 4096
LONGEST_MM = 10_000.0
MOST_OFF = 0.1  # of the nominal radius
ROWS_NEEDED = 8
FEWEST_OF_A_CIRCLE = 3
BAR_SIGMA_MM = 0.001
REMEDY = "Name columns angle_deg and radius_mm, or angle_deg and deviation_um with a line 'Nominal radius (mm): 100'."


@dataclass(frozen=True)
class BallBar:
    """``angle_deg``, ``radius_mm``, ``run`` (from 1) and ``line`` (n); ``joints`` by contract name where logged."""

    path: Path
    nominal_mm: float
    angle_deg: Floats
    radius_mm: Floats
    run: NDArray[np.int64]
    line: NDArray[np.int64]
    joints: dict[str, Floats]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def is_ballbar(layout: TextLayout) -> bool:
    """Tell whether a text's columns are an angle and a radius, or its deviation and no time."""
    names = [canonical_column_name(name) for name in layout.names]
    radius, deviation = (any(map(pattern.match, names)) for pattern in (RADIUS, DEVIATION))
    return any(map(ANGLE.match, names)) and (radius or (deviation and not any(name in TIME for name in names)))


def read_ballbar(path: Path, nominal_mm: float | None = None) -> BallBar:
    """Read a ball bar log.

    Raises:
        FileError: no angle and radius, a deviation without nominal radius, a unit that is missing, a cell that is not
            a number, a radius far from the nominal one.

    """
    layout = sniff(path)
    angle = _column(layout, ANGLE)
    radius, deviation = _column(layout, RADIUS), _column(layout, DEVIATION)
    length = radius if radius is not None else deviation
    if angle is None or length is None:
        raise fault(path, f"no angle and radius among {', '.join(layout.names[:12])}", REMEDY, line=layout.first_line)
    joints = {i: name for i, name in enumerate(layout.names) if JOINT.match(name.lower())}
    values, run, line, cut = _rows(path, layout, [angle, length, *joints])
    degrees = _convert_to_unit(path, layout, angle, values[:, 0], "deg", "deg")
    if layout.units[angle] is None and np.ptp(degrees) < 6.5 and len(degrees) > 20:
        what = f"rotates by only {np.ptp(degrees):.3g} in all: are these radians"
        raise fault(path, what, "State the unit: angle_rad or angle_deg.", column=layout.names[angle])
    lengths = _convert_to_unit(path, layout, length, values[:, 1], "mm", None)
    said = nominal_mm or _nominal(path, layout)
    nominal = said or (float(np.median(lengths)) if radius is not None else None)
    if nominal is None:
        raise fault(path, "deviations without the nominal radius", REMEDY, column=layout.names[length])
    radii = lengths if radius is not None else lengths + nominal
    _refuse(path, radii, nominal, line, layout.names[length])
    columns = {}
    for k, (i, name) in enumerate(joints.items()):
        unit = layout.units[i]
        if unit not in ("deg", "rad", "mm", "m"):
            raise fault(path, "a joint without unit", "Call it q1_deg or q1_rad.", column=name)
        columns[f"{name.lower()}_{unit}"] = values[:, 2 + k]
    origin = "" if said else ", the median: none is stated"
    notes = (f"nominal radius {nominal:g} mm{origin}", f"{len(radii)} readings in {int(run.max())} runs")
    return BallBar(path, nominal, degrees, radii, run, line, columns, notes, () if cut is None else (cut,))


def _column(layout: TextLayout, pattern: re.Pattern[str]) -> int | None:
    return next((i for i, name in enumerate(layout.names) if pattern.match(canonical_column_name(name))), None)


def _rows(
    path: Path, layout: TextLayout, columns: list[int]
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], str | None]:
    """Numbers (n, columns) with their run and line; a title, or the header again, begins the next run.

    A last line that breaks off is left out, with a remark.
    """
    rows: list[list[float]] = []
    runs: list[int] = []
    lines: list[int] = []
    run, titled = 1, False
    broken: tuple[FileError, str | None] | None = None
    for number, text in numbered_lines(path, layout):
        if broken is not None:
            raise broken[0]
        if len(text) > LONGEST_LINE:
            raise fault(path, f"a line of {len(text)} characters", "Export it as text again.", line=number)
        cells = layout.split(text)
        found = [parse_number(cells[i], layout.decimal) if i < len(cells) else None for i in columns]
        if len(cells) == layout.width and all(value is not None and math.isfinite(value) for value in found):
            run += titled and bool(rows)
            titled = False
            rows.append([float(value) for value in found if value is not None])
            runs.append(run)
            lines.append(number)
        elif _is_title(cells, layout):
            titled = True
        else:
            what = f"{text.strip()[:60]!r} is not a row of {layout.width} numbers"
            error = fault(path, what, "Correct the row; other notes belong above the table.", line=number)
            broken = error, cut_remark(number, len(cells), layout.width)
            if broken[1] is None:
                raise error
        if len(rows) > MOST_ROWS:
            raise fault(path, f"has more than {MOST_ROWS} rows", "Split the file.", line=number)
    if len(rows) < ROWS_NEEDED:
        raise fault(path, f"has {len(rows)} readings", f"At least {ROWS_NEEDED} are needed to see a circle.")
    turned = _split_runs_at_reversal(np.array([row[0] for row in rows]), np.array(runs))
    return np.array(rows), turned, np.array(lines), None if broken is None else broken[1]


def _is_title(cells: list[str], layout: TextLayout) -> bool:
    """A line between runs: it names one, or it is the header or the row of units again, or ends with a colon."""
    words = [cell for cell in cells if cell]
    text = " ".join(words)
    known = {canonical_column_name(name) for name in layout.names}
    again = bool(words) and all(
        canonical_column_name(re.sub(r"[\[(].*?[\])]|_[a-zµ]+$", "", word)) in known
        or word.strip("[]()").lower() in UNITS
        for word in words
    )
    return again or bool(RUN.search(text)) or (bool(text) and (":" in text or "=" in text) and len(text) < 200)


def _split_runs_at_reversal(angle: Floats, run: NDArray[np.int64]) -> NDArray[np.int64]:
    """Begin a run also where the bar reverses for good."""
    step = np.diff(angle)
    way = np.sign(np.where(np.abs(step) > 180, 0.0, step))
    out = run.copy()
    for r in np.unique(run):
        inside = np.flatnonzero(run[:-1] == r)
        ways = way[inside]
        if len(ways) >= 4 * ROWS_NEEDED and min(np.mean(ways > 0), np.mean(ways < 0)) > 0.2:
            # The one place where most steps before go one way and most after the other.
            sums = np.cumsum(ways)
            cut = int(np.argmax(np.abs(2 * sums - sums[-1])))
            out[inside[cut] + 1 :] += 1
    return out


def _convert_to_unit(
    path: Path, layout: TextLayout, column: int, values: Floats, unit: str, default: str | None
) -> Floats:
    stated = layout.units[column] or default
    convert = converter(stated, unit) if stated else None
    if convert is None:
        what = f"is in {stated or 'no stated unit'}"
        raise fault(path, what, f"State a unit that can be {unit}, in the column's name.", column=layout.names[column])
    return values * convert(1.0)


def _nominal(path: Path, layout: TextLayout) -> float | None:
    for cells in layout.above:
        match = NOMINAL.search(" ".join(cells))
        if match is None:
            continue
        unit = UNITS.get((match["before"] or match["after"] or "mm").lower().strip())
        convert = converter(unit, "mm") if unit else None
        value = float(match["value"].replace(",", "."))
        if convert is not None and 0 < convert(value) < LONGEST_MM:
            return convert(value)
        raise fault(
            path, f"its nominal radius {match.group(0)[:60]!r} cannot be", "Correct it.", line=layout.first_line
        )
    return None


def _refuse(path: Path, radii: Floats, nominal: float, line: NDArray[np.int64], column: str) -> None:
    if not 0 < nominal < LONGEST_MM:
        raise fault(path, f"a nominal radius of {nominal:g} mm", "No ball bar has that: check the unit.")
    wild = np.abs(radii - nominal) > MOST_OFF * nominal
    if wild.any():
        row = int(np.argmax(wild))
        what = f"a radius of {radii[row]:.6g} mm is more than a tenth off the nominal {nominal:g} mm"
        raise fault(
            path, what, "Check the unit of the column and the nominal radius.", line=int(line[row]), column=column
        )


def circle_fit_by_run(found: BallBar) -> list[dict[str, Any]]:
    """Return each run's direction, centre, radius and circularity: the spread left when a circle is fitted.

    A run that broke off before its third reading has no circle and is left out.
    """
    out = []
    for run in np.unique(found.run):
        here = found.run == run
        if np.count_nonzero(here) < FEWEST_OF_A_CIRCLE:
            continue
        turn, radius = np.radians(found.angle_deg[here]), found.radius_mm[here]
        A = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)
        level, x, y = np.linalg.lstsq(A, radius, rcond=None)[0]
        rest = radius - A @ np.array([level, x, y])
        step = np.diff(found.angle_deg[here])
        out.append(
            {
                "run": int(run),
                "readings": int(here.sum()),
                "direction": "ccw" if float(np.median(step)) > 0 else "cw",
                "from_deg": round(float(found.angle_deg[here][0]), 4),
                "to_deg": round(float(found.angle_deg[here][-1]), 4),
                "mean_radius_mm": round(float(level), 5),
                "centre_mm": [round(float(x), 5), round(float(y), 5)],
                "circularity_mm": round(float(np.ptp(rest)), 5),
            }
        )
    return out


def ballbar_table(path: Path) -> Table:
    """Read a ball bar log with joints as lengths of a bar (``bar_id``, ``bar_mm``): each run about a centre mount of its own.

    Raises:
        FileError: no joints in the file, or whatever ``read_ballbar`` refuses.

    """
    found = read_ballbar(path)
    if not found.joints:
        raise FileError(
            f"{path}: has angle and radius but no joints, so no pose of the robot. Add q1_deg ... to the file, or join "
            "it with the joint log (kilter measure sheet-join).",
            file=str(path),
        )
    columns = {name: [float(v) for v in values] for name, values in found.joints.items()}
    columns["bar_id"] = [float(run) for run in found.run]
    columns["bar_mm"] = [round(float(v), 6) for v in found.radius_mm]
    table = Table(columns, [int(line) for line in found.line], list(found.notes), list(found.warnings))
    table.notes.append(
        "bar_id counts the runs: give runs about one centre mount the same number to determine the scale of the arm better"
    )
    return table


def describe_inclinometer(head: Head) -> Document:
    """Describe the log of an inclinometer."""
    assert head.layout is not None  # it was recognised
    found = read_inclinometer(head.path, head.hints.unit)
    columns = [column(name, column_unit(name), values) for name, values in found.columns.items()]
    rows = len(found.columns["t_s"])
    told = {"notes": list(found.notes), "warnings": list(found.warnings)}
    shape = {"layout": head.layout.to_document()}
    return {"rows": rows, "columns": columns} | told | shape


def describe_ballbar(head: Head) -> Document:
    """Describe the log of a ball bar; with joints it is ready to be sent."""
    assert head.layout is not None  # it was recognised
    found = read_ballbar(head.path)
    measured = {"angle_deg": ("deg", found.angle_deg), "radius_mm": ("mm", found.radius_mm)}
    columns = [column(name, unit, values) for name, (unit, values) in measured.items()]
    columns += [column(name, column_unit(name), values) for name, values in found.joints.items()]
    runs = circle_fit_by_run(found)
    notes = [*found.notes]
    for run in runs:
        x, y = run["centre_mm"]
        size = f"circularity {1000 * run['circularity_mm']:.1f} um about its centre ({x:+.4f}, {y:+.4f}) mm"
        notes.append(f"run {run['run']}, {run['direction']}: {size}, mean radius {run['mean_radius_mm']:.4f} mm")
    notes.append(
        "ready for kilter upload --device ballbar"
        if found.joints
        else "joins a joint log with kilter measure sheet-join"
    )
    told = {"notes": notes, "warnings": list(found.warnings), "ready": bool(found.joints), "device": "ballbar"}
    shape = {"layout": head.layout.to_document()}
    return {"rows": len(found.radius_mm), "columns": columns, "runs": runs} | told | shape


TILT = re.compile(r"^(?:incl|inclination|inclinometer|tilt|angle|slope|neigung|level)[a-z]*?([xy12]?)$")
TIME = ("t", "time", "timestamp", "zeit", "elapsedtime")
AXES = {"": "x", "x": "x", "1": "x", "y": "y", "2": "y"}
STEEPEST_DEG = 181.0


@dataclass(frozen=True)
class Inclinations:
    """``columns``: t_s, tilt_x_deg, and tilt_y_deg where there is one."""

    columns: Mapping[str, Floats]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def tilt_column_indices(layout: TextLayout) -> dict[str, int]:
    """Return which column is the inclination x and y; empty when it is not an inclinometer's file."""
    found: dict[str, int] = {}
    for i, name in enumerate(layout.names):
        match = TILT.match(canonical_column_name(name))
        if match:
            found.setdefault(AXES[match[1]], i)
    return found


def read_inclinometer(path: Path, unit: str | None = None) -> Inclinations:
    """Read an inclinometer log; ``unit`` overrides what the file says of its angles.

    Raises:
        FileError: no inclination or time among the columns, no unit, an angle that cannot be, time that goes back.

    """
    layout = sniff(path)
    tilts = tilt_column_indices(layout)
    time = next((i for i, name in enumerate(layout.names) if canonical_column_name(name) in TIME), None)
    if not tilts or time is None:
        said = ", ".join(layout.names[:12])
        raise fault(path, f"no time and inclination among {said}", "Name the columns so.", line=layout.first_line)
    wanted = sorted({time, *tilts.values()})
    rows, cut = count_rows(path, layout)
    raw = np.concatenate(list(blocks(path, layout, wanted, rows)))
    t = raw[:, wanted.index(time)] * SIZES["time"].get(layout.units[time] or "s", 1.0)
    _refuse_inclinometer(path, layout, np.isnan(raw).any(axis=1), "a cell is empty", None)
    _refuse_inclinometer(path, layout, np.diff(t, prepend=-np.inf) < 0, "time goes back: two logs concatenated", time)
    columns: dict[str, Floats] = {"t_s": t - t[0]}
    notes, warnings = [], [] if cut is None else [cut]
    for axis, tilt in sorted(tilts.items()):
        told = layout.units[tilt]
        stated = unit or told
        convert = converter(stated, "deg") if stated else None
        if convert is None:
            what = f"its angles are in {stated or 'no stated unit'}"
            raise fault(path, what, "Give the unit: deg, rad, mrad (mm/m), arcmin.", column=layout.names[tilt])
        angle = raw[:, wanted.index(tilt)] * convert(1.0)
        wild = np.abs(angle) > STEEPEST_DEG
        if wild.any():
            raise _too_steep(path, layout, int(np.argmax(wild)), tilt, str(stated))
        if told is not None and unit is not None and told != unit:
            warnings.append(f"{layout.names[tilt]!r} taken as {unit}, as you say; the file says {told}")
        columns[f"tilt_{axis}_deg"] = angle
        notes.append(f"tilt_{axis}_deg from {layout.names[tilt]!r} [{stated}]")
    return Inclinations(columns, tuple(notes), tuple(warnings))


def _too_steep(path: Path, layout: TextLayout, row: int, column: int, stated: str) -> FileError:
    """Say which smaller unit the angles may be in."""
    smaller = [unit for unit in ("deg", "mrad", "arcmin", "arcsec") if SIZES["angle"][unit] < SIZES["angle"][stated]]
    factors = [f"{unit} ({SIZES['angle'][unit] / SIZES['angle'][stated]:.4g} of it)" for unit in smaller]
    what = f"more than 180 degrees, declared as {stated}: are these {' or '.join(factors) or 'no angles'}"
    remedy = f"Give the unit (--unit {smaller[0]}), or correct the row." if smaller else "Correct the row."
    return fault(path, what, remedy, line=line_number_of_row(path, layout, row), column=layout.names[column])


def _refuse_inclinometer(
    path: Path,
    layout: TextLayout,
    wrong: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    what: str,
    column: int | None,
) -> None:
    if wrong.any():
        line = line_number_of_row(path, layout, int(np.argmax(wrong)))
        place = {} if column is None else {"column": layout.names[column]}
        raise fault(path, what, "Correct the row, or export again.", line=line, **place)
