"""Points of trackers and measuring machines, exported as text."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kilter_files.formats.marker_header import PRESETS, Preset, meaning, unit_above
from kilter_files.formats.reader import NO_HINTS, PRESET, Document, Head, Hints, Reader, column
from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import fault
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import blocks, count_rows, line_number_of_row, numbered_lines
from kilter_files.ground.text_layout import TextLayout, sniff
from kilter_files.ground.time_stamps import continuous_seconds, parse_stamp, parse_stamp_column, times_of_rows
from kilter_files.ground.units import SIZES, column_unit, converter, from_euler, is_sequence
from kilter_files.tables.table import Table


def stamped_times(path: Path, layout: TextLayout, means: Mapping[str, int], rows: int) -> Floats | None:
    """Return the seconds of a column of time stamps, NaN where a cell is empty; None where the column holds numbers.

    Raises:
        FileError: a cell that is not a time stamp among others that are.

    """
    column = means.get("t")
    if column is None:
        return None
    cells = [(line, layout.split(text)) for line, text in itertools.islice(numbered_lines(path, layout), rows)]
    texts = [(line, row[column] if column < len(row) else "") for line, row in cells]
    first = next((text for _, text in texts if text), "")
    if parse_number(first, layout.decimal) is not None or parse_stamp(first) is None:
        return None
    told = [(line, text) for line, text in texts if text]
    lines = [line for line, _ in told]
    stamps = parse_stamp_column([text for _, text in told], lines, path, layout.names[column])
    seconds = iter(continuous_seconds(stamps))
    return np.array([next(seconds) if text else np.nan for _, text in texts])


K95 = 2.0  # trackers state U95 with the coverage factor 2
AXES = ("x", "y", "z")
JOINT = re.compile(r"q\d+_(deg|rad|mm|m)")
FRAME = re.compile(r"(?:frame|coordinate system|coord\w* sys\w*|alignment)\s*[:=]\s*(\S[^;,]{0,60})", re.I)
LONGEST_S = 30 * 86_400.0


@dataclass
class _Export:
    path: Path
    layout: TextLayout
    preset: Preset
    means: dict[str, int]
    rows: int
    euler: str | None
    columns: dict[str, Floats] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def read_tracker(
    path: Path, preset: str = "generic", euler: str | None = None, joints: Mapping[str, Floats] | None = None
) -> Table:
    """Read a text export; ``euler`` is the order of its angles, as in a column map, before the preset's.

    ``joints`` are columns of another file, a row for each point.

    Raises:
        FileError: no x, y and z, angles of unknown order, a damaged row; line, column and remedy are named.

    """
    layout = sniff(path)
    chosen = PRESETS[preset]
    means = meaning(layout.names, chosen) if layout.header else _without_header(path, layout)
    if not set(AXES) <= set(means):
        said = ", ".join(layout.names[:12])
        remedy = "Write a column map (kilter measure inspect FILE --draft columns.toml)."
        raise fault(path, f"no columns x, y and z among {said}", remedy, line=layout.first_line)
    rows, cut = count_rows(path, layout)
    export = _Export(path, layout, chosen, means, rows, euler or chosen.euler)
    export.warnings += [] if cut is None else [cut]
    stamped = stamped_times(path, layout, means, rows)
    numeric = {key: column for key, column in means.items() if key != "t" or stamped is None}
    raw = np.concatenate(list(blocks(path, layout, sorted(set(numeric.values())), export.rows)))
    place = {column: i for i, column in enumerate(sorted(set(numeric.values())))}
    values = {key: raw[:, place[column]] for key, column in numeric.items()}
    if stamped is not None:
        values["t"] = stamped
    _position(export, values)
    _orientation(export, values)
    _spread(export, values)
    _joints_and_more(export, values)
    _join_joint_columns(export, joints)
    _frame(export)
    return _table(export)


def _without_header(path: Path, layout: TextLayout) -> dict[str, int]:
    """The first three columns of numbers are x, y, z, after the names of the points."""
    _, first = next(numbered_lines(path, layout))
    numbers = [
        i for i, cell in enumerate(layout.split(first)) if cell and parse_number(cell, layout.decimal) is not None
    ]
    texts = [i for i, cell in enumerate(layout.split(first)) if i not in numbers]
    found = [i for i in numbers if i > max(texts, default=-1)] if texts and texts[-1] < 4 else numbers
    return dict(zip(AXES, found[:3], strict=False)) if len(found) >= 3 else {}


def _unit(export: _Export, key: str, default: str) -> str:
    return export.layout.units[export.means[key]] or default


def _position(export: _Export, values: dict[str, Floats]) -> None:
    default = unit_above(export.layout) or export.preset.length
    for axis in AXES:
        unit = _unit(export, axis, default)
        if unit not in SIZES["length"]:
            raise fault(
                export.path, f"is in {unit}, not a length", "Are the columns shifted?", column=_name(export, axis)
            )
        export.columns[f"{axis}_mm"] = values[axis] * (SIZES["length"][unit] / SIZES["length"]["mm"])
        stated = export.layout.units[export.means[axis]] or unit_above(export.layout)
        export.notes.append(f"{axis}_mm from {_name(export, axis)!r} [{unit}{'' if stated else ', not stated'}]")


def _orientation(export: _Export, values: dict[str, Floats]) -> None:
    if all(f"q{part}" in values for part in "wxyz"):
        turned = np.stack([values[f"q{part}"] for part in "wxyz"], axis=1)
        size = np.linalg.norm(turned, axis=1)
        _refuse(
            export, np.abs(size - 1) > 0.02, "qw", "not a unit quaternion with its neighbours: columns shifted here?"
        )
        for i, part in enumerate("wxyz"):
            export.columns[f"q{part}"] = turned[:, i] / size
        export.notes.append("qw, qx, qy, qz from the quaternion")
    elif all(f"r{axis}" in values for axis in AXES):
        _euler(export, values)


def _euler(export: _Export, values: dict[str, Floats]) -> None:
    if export.euler is None or not is_sequence(export.euler):
        remedy = "Give it (--euler XYZ about the moving axes, xyz about the fixed ones) or a preset that knows it."
        raise fault(export.path, "three angles, but their order is not known", remedy, column=_name(export, "rx"))
    for axis in AXES:
        unit = _unit(export, f"r{axis}", "deg")
        convert = converter(unit, "rad")
        if convert is None:
            raise fault(export.path, f"is in {unit}, not an angle", "Correct it.", column=_name(export, f"r{axis}"))
        values[f"r{axis}"] = values[f"r{axis}"] * convert(1.0)
        wild = np.abs(values[f"r{axis}"]) > 2 * math.pi + 0.1
        _refuse(export, wild, f"r{axis}", f"more than a full turn, declared as {unit}: are these degrees?")
    angles = np.stack([values[f"r{axis}"] for axis in AXES], axis=1)
    turned = np.array([from_euler((a, b, c), export.euler) for a, b, c in angles.tolist()])
    for i, part in enumerate("wxyz"):
        export.columns[f"q{part}"] = turned[:, i]
    export.notes.append(f"qw, qx, qy, qz from the angles, order {export.euler}")


def _spread(export: _Export, values: dict[str, Floats]) -> None:
    default = _unit(export, "x", unit_above(export.layout) or export.preset.length)
    for kind, factor in (("s", 1.0), ("u95", 1 / K95)):
        if all(f"{kind}{axis}" in values for axis in AXES):
            for axis in AXES:
                to_mm = SIZES["length"].get(_unit(export, f"{kind}{axis}", default), 1e-3) / SIZES["length"]["mm"]
                _refuse(export, values[f"{kind}{axis}"] < 0, f"{kind}{axis}", "a negative uncertainty")
                export.columns[f"s{axis}_mm"] = values[f"{kind}{axis}"] * to_mm * factor
            export.notes.append("sx_mm, sy_mm, sz_mm " + ("as stated" if kind == "s" else "from U95, divided by 2"))
            return
    if "u95" in values:
        to_mm = SIZES["length"].get(_unit(export, "u95", default), 1e-3) / SIZES["length"]["mm"]
        _refuse(export, values["u95"] < 0, "u95", "a negative uncertainty")
        for axis in AXES:
            export.columns[f"s{axis}_mm"] = values["u95"] * to_mm / K95 / math.sqrt(3)
        export.notes.append("sx_mm, sy_mm, sz_mm from the total U95, divided by 2 and by the root of 3")


def _joints_and_more(export: _Export, values: dict[str, Floats]) -> None:
    joints = sorted((key for key in values if key[0] == "j"), key=lambda key: int(key[1:]))
    for key in joints:
        unit = export.layout.units[export.means[key]]
        if unit not in ("deg", "rad", "mm", "m"):
            export.warnings.append(f"joints left out: {_name(export, key)!r} states no unit")
            break
        _refuse(export, (np.abs(values[key]) > 4.2 * math.pi) & (unit == "rad"), key, "more than two turns: degrees?")
        export.columns[f"q{key[1:]}_{unit}"] = values[key]
    if "temperature" in values:
        export.columns["temperature_c"] = values["temperature"]
    if "t" in values:
        t = values["t"] * SIZES["time"].get(_unit(export, "t", "s"), 1.0)
        if np.isnan(t).any() or (np.diff(t) < 0).any() or not 0 < t[-1] - t[0] < LONGEST_S:
            export.warnings.append(f"{_name(export, 't')!r} left out: it is not a time in seconds that goes on")
        else:
            export.columns["t_s"] = np.asarray(times_of_rows(t.tolist()), dtype=np.float64)


def _join_joint_columns(export: _Export, joints: Mapping[str, Floats] | None) -> None:
    """Join columns of another file; points and joints must be as many, before any row is left out."""
    if joints is None:
        return
    if any(JOINT.fullmatch(name) for name in export.columns):
        what = "holds joints of its own"
        raise fault(export.path, what, "Leave out --joints.", line=export.layout.first_line)
    count = len(next(iter(joints.values())))
    if count != export.rows:
        what = f"{export.rows} points, but {count} poses of joints"
        raise fault(export.path, what, "Bring both files to the same poses in the same order.")
    export.columns = {**joints, **export.columns}


def _frame(export: _Export) -> None:
    """Say which coordinate frame the header names."""
    for cells in export.layout.above:
        match = FRAME.search(" ".join(cells))
        if match:
            export.notes.append(f"coordinate frame: {match[1].strip()}")
            return


def _table(export: _Export) -> Table:
    lines = [line for line, _ in itertools.islice(numbered_lines(export.path, export.layout), export.rows)]
    absent = np.zeros(export.rows, bool)
    for name, values in export.columns.items():
        absent |= np.isnan(values)
        if name[0] == "s":
            absent |= values <= 0
    zero = np.all([export.columns[f"{axis}_mm"] == 0 for axis in AXES], axis=0)
    table = Table({name: values.tolist() for name, values in export.columns.items()}, lines, export.notes)
    left = np.flatnonzero(absent | zero)
    if len(left):
        what = "a cell is empty or x, y and z are zero"
        export.warnings.append(f"{len(left)} rows left out because {what} (line {lines[left[0]]})")
        table.keep(np.flatnonzero(~(absent | zero)).tolist())
    used = set(export.means.values())
    other = [n for i, n in enumerate(export.layout.names) if i not in used and n and export.layout.header]
    table.warnings += export.warnings + ([f"columns left out: {', '.join(other)}"] if other else [])
    if not len(table):
        raise fault(export.path, "no row is left", "Export the points with their coordinates.", line=lines[0])
    return table


def _refuse(export: _Export, wrong: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], key: str, what: str) -> None:
    if wrong.any():
        line = line_number_of_row(export.path, export.layout, int(np.argmax(wrong)))
        raise fault(export.path, what, "Correct the row, or export again.", line=line, column=_name(export, key))


def _name(export: _Export, key: str) -> str:
    return export.layout.names[export.means[key]]


def describe_points(head: Head, table: Table) -> Document:
    """Describe points that were read, and say which of them are suspicious."""
    assert head.layout is not None  # it was recognised
    columns = [column(name, column_unit(name), np.array(values)) for name, values in table.columns.items()]
    return {
        "layout": head.layout.to_document(),
        "rows": len(table),
        "columns": columns,
        "notes": table.notes,
        "warnings": table.warnings + _plausibility_warnings(table.columns),
    }


def _plausibility_warnings(columns: dict[str, list[float]]) -> list[str]:
    points = np.array([columns[f"{axis}_mm"] for axis in "xyz"]).T
    size = float(np.abs(points).max())
    same = len(points) - len(np.unique(points, axis=0))
    out = [f"{same} points are copies of others to the last digit"] if same else []
    if size < 20.0 and len(points) > 5:
        out.append(f"no coordinate is beyond {size:.3g} mm: are these metres declared as mm, 1000 times larger")
    return out


class TrackerText(Reader[Table]):
    """Points, or poses, in the way of a program."""

    name = "tracker-text"
    title = "points exported as text"
    use = PRESET

    def recognises(self, head: Head) -> bool:
        """Whatever text no other reader knows."""
        return True

    def describe(self, head: Head) -> Document:
        """Ranges of the coordinates, and points that cannot be right."""
        return describe_points(head, self.read(head.path, head.hints))

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Read the points, with the joints of the hints beside them."""
        return read_tracker(path, hints.preset, hints.euler, hints.joints)

    def names_and_titles(self) -> Iterator[tuple[str, str]]:
        """Each preset."""
        for name, preset in PRESETS.items():
            yield name, f"{self.title}: {preset.title}"


READER = TrackerText()
