"""A first column map for an unknown file: what names and ranges tell, and marks where they do not."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kilter_files.formats.reader import NO_HINTS, Document, Hints
from kilter_files.formats.registry import describe
from kilter_files.formats.unknown.guess import ASK_INSTRUMENT, COMMANDED, COMPUTED, Columns, Entry, name_as_words
from kilter_files.formats.unknown.table_shape import TableShape
from kilter_files.formats.unknown.turns import Turned
from kilter_files.formats.unknown.understood import Understood, joined_names, understand
from kilter_files.ground.errors import UsageError
from kilter_files.ground.time_stamps import clusters
from kilter_files.ground.units import JOINT, UNKNOWN, converter

SAME_DEG = 0.01
AXES_MM = ("x_mm", "y_mm", "z_mm")
MOST_STATES = 6
JOIN = """
# Joints in another file? Then delete the line q* above and take the # away here:
# [join]
# path = "joints.csv"            # beside this file
# by = "row"                     # or "id" or "time", with here = "a column of this file" and there = "one of the other"
# [join.columns]
# "q*" = { from = "A*", unit = "deg" }
"""
POSES = f"""
# Poses measured several times? Then their repeats are found by equal joints:
# [pose_id]
# same_joints_within_deg = {SAME_DEG}"""


@dataclass
class Draft:
    """A drafted map: its text, the places that have to be filled in, what was guessed, and columns nobody uses.

    ``readings`` says in a line what is read from which columns, ``rivals`` which other columns might be it.
    ``least_reach_mm`` is of joints in radians by their size: as degrees, only an arm that reaches further moves as measured.
    """

    text: str
    open: list[str] = field(default_factory=list)
    guessed: list[str] = field(default_factory=list)
    used: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)
    readings: str = ""
    rivals: list[str] = field(default_factory=list)
    least_reach_mm: float | None = None

    @property
    def has_contract_joints(self) -> bool:
        """Whether joints have the names of the contract, as in a file that needs no map."""
        return any(JOINT.fullmatch(name) for name in (*self.used, *self.unused))

    def save(self, path: Path | str) -> None:
        """Write the map, never over a file that is there.

        Raises:
            UsageError: there is such a file.

        """
        if Path(path).exists():
            raise UsageError(f"{path}: is there already. Name another file, or delete it.")
        Path(path).write_text(self.text, encoding="utf-8")

    def to_document(self) -> dict[str, Any]:
        """Return what is to be said about the draft."""
        return {"open": self.open, "guessed": self.guessed, "used": self.used, "unused": self.unused}


def draft(path: Path, robot: Sequence[str] = ()) -> Draft:
    """Draft a column map for a file; ``robot`` are the joints of the arm, prismatic ones with ``:m`` at the end.

    Raises:
        FileError: no table of numbers is found in it.

    """
    found = understand(path, robot)
    columns, turn, axes = found.columns, found.turn, found.axes
    lines = [_file(found.shape), "[columns]", *(_line(columns, entry) for entry in found.entries)]
    patterns = [pattern for pattern in found.other_joints if not any(_matches(pattern, name) for name in found.taken)]
    lines += [f"# other columns that might be the joints: {joined_names(patterns)}"] if patterns else []
    lines += (
        [f"# other columns that might be the position: {joined_names(found.other_places)}"]
        if found.other_places
        else []
    )
    lines += [f"# not used: {joined_names(found.unused_columns)}"] if found.unused_columns else []
    lines += [] if axes else [JOIN.rstrip(), POSES]
    lines += ["", *_orientation_lines(columns, turn)] if turn else []
    lines += _poses(columns, found.entries, axes) + _rows(columns, found.entries, found.unused_columns)
    text = _top(path, found.open) + "\n".join(lines) + "\n"
    used, reach = sorted(found.taken), _least_reach(found)
    rivals = _rivals(found, patterns)
    return Draft(text, found.open, found.guess_remarks, used, found.unused_columns, _readings(found), rivals, reach)


def _rivals(found: Understood, joints: Sequence[str]) -> list[str]:
    """Return what else might be the joints or the position: not what was commanded, or computed beside a measurement."""
    out = [f"joints {one}" for one in joints if not COMMANDED.search(name_as_words(one))]
    places = [name_as_words(one) for one in found.other_places]
    out += [f"position {one}" for one in places if not COMMANDED.search(one) and not COMPUTED.search(one)]
    asked = any(ASK_INSTRUMENT in entry.remark for entry in found.entries)
    return [*out, *(["no measurement: a position that the controller computes from its joints"] if asked else [])]


def _readings(found: Understood) -> str:
    """Return what is read, in a line: joints and position from the first to the last of their columns."""
    place = [entry for entry in found.entries if entry.target in AXES_MM]
    others = [entry.target for entry in found.entries if entry not in (*found.axes, *place)]
    parts = [_span("joints", found.axes), _span("position", place), *others, *(["orientation"] if found.turn else [])]
    return "; ".join(part for part in parts if part)


def _span(words: str, entries: Sequence[Entry]) -> str:
    sources = list(dict.fromkeys((entries[0].source, entries[-1].source))) if entries else []
    named = " ... ".join(sources)
    units = f"[{'/'.join(dict.fromkeys(str(entry.unit) for entry in entries))}]"
    return "" if not sources else f"{words} {named}" if named.endswith(units) else f"{words} {named} {units}"


def _least_reach(found: Understood) -> float | None:
    guessed = [name for entry in found.axes if entry.unit == "rad" and entry.remark for name in entry.used]
    place = [entry for entry in found.entries if entry.target in AXES_MM and not entry.open]
    convert = converter(place[0].unit or "mm", "mm") if place else None
    turned = math.radians(sum(_span_of_values(found.columns, name) for name in guessed))  # were they degrees
    if convert is None or len(place) < len(AXES_MM) or not turned:
        return None
    moved = math.hypot(*(_span_of_values(found.columns, entry.source) for entry in place))
    return (convert(moved) - convert(0.0)) / turned


def _span_of_values(columns: Columns, name: str) -> float:
    values = columns.numbers(name)
    return max(values) - min(values) if values else 0.0


def _matches(pattern: str, name: str) -> bool:
    before, _, after = pattern.partition("*")
    return name.startswith(before) and name.endswith(after)


def _top(path: Path, places: Sequence[str]) -> str:
    told = f"Fill in what is marked {UNKNOWN}: {', '.join(places)}." if places else "Nothing has to be filled in."
    return (
        f"# Drafted from {path.name}. {told} Check the rest: kilter upload ROBOT FILE --map THIS --dry-run\n"
        "# shows the range of every column in mm and deg. All keys: docs/reference/column-maps.md\n\n"
    )


def _file(shape: TableShape) -> str:
    layout, out = shape.layout, ["[file]", f"format = {_toml_literal(shape.form)}"]
    if shape.form == "csv":
        out += [f"delimiter = {_toml_literal(layout.delimiter)}", f"encoding = {_toml_literal(layout.encoding)}"]
    if shape.form in ("csv", "xlsx"):
        out.append(f"decimal = {_toml_literal(layout.decimal)}")
    if layout.sheet is not None:
        out.append(f"sheet = {_toml_literal(str(layout.sheet))}")
    out += [f"skip_rows = {layout.skip_rows}"] if layout.skip_rows else []
    out += ["units_row = true"] if layout.units_row else []
    out += [f"comment = {_toml_literal(layout.comment)}"] if layout.comment else []
    out += [f"rows_per_pose = {layout.rows_per_pose}         # rows that make a matrix together"] * (
        layout.rows_per_pose > 1
    )
    if layout.missing:
        listed = ", ".join(_toml_literal(str(word)) for word in layout.missing)
        out.append(f"missing = [{listed}]   # words in columns of numbers")
    out += ["header = false            # columns are given by their index, from 0"] if not layout.header else []
    return "\n".join(out) + "\n"


def _line(columns: Columns, entry: Entry) -> str:
    key = _toml_literal(entry.target) if "*" in entry.target else entry.target
    source = entry.source if entry.source == UNKNOWN or "*" in entry.target else columns.key(entry.source)
    unit = f", unit = {_toml_literal(entry.unit)}" if entry.unit else ""
    mark = f"   # {UNKNOWN} {entry.remark}" if entry.open else f"   # {entry.remark}" if entry.remark else ""
    return f"{key} = {{ from = {_toml_literal(source)}{unit} }}{mark}"


def _orientation_lines(columns: Columns, turn: Turned) -> list[str]:
    listed = ", ".join(_toml_literal(columns.key(name)) for name in turn.names)
    out = ["[orientation]", f"from = [{listed}]"]
    mark = f"   # {turn.remark}" if turn.remark else ""
    if turn.quaternion:
        return [*out, f"quaternion = {_toml_literal(turn.quaternion)}{mark}"]
    if turn.matrix:
        return [*out, f"matrix = {_toml_literal(turn.matrix)}{mark}"]
    return [*out, f"euler = {_toml_literal(turn.euler)}{mark}", f"unit = {_toml_literal(turn.unit)}"]


def _poses(columns: Columns, entries: Sequence[Entry], axes: Sequence[Entry]) -> list[str]:
    """Number the poses by equal joints where joints come back and no column numbers them."""
    names = [name for entry in axes for name in entry.used]
    values = [columns.numbers(name) or [] for name in names]
    if any(entry.target == "pose_id" for entry in entries) or not names or len({len(v) for v in values}) != 1:
        return []
    convert = converter(axes[0].unit or "deg", "deg") or float
    labels = list(zip(*(clusters([convert(v) for v in column], SAME_DEG) for column in values), strict=True))
    if len(set(labels)) == len(labels):
        return []
    return [
        "",
        "[pose_id]",
        f"same_joints_within_deg = {SAME_DEG}   # {len(set(labels))} poses among {len(labels)} rows",
    ]


def _rows(columns: Columns, entries: Sequence[Entry], unused: Sequence[str]) -> list[str]:
    rows = len(columns.shape.source.lines)
    used = [name for entry in entries if not entry.target.startswith("m") for name in entry.used]
    empty = max(
        (rows - len(columns.numbers(name) or ()) for name in used if columns.numbers(name) is not None), default=0
    )
    out = [f"drop_missing = true   # {empty} rows or more have an empty cell"] if rows and empty > 0 else []
    for name in unused:
        states = (
            sorted({text for text in columns.texts(name) if text}, key=_good_first)
            if columns.numbers(name) is None
            else []
        )
        if 1 < len(states) <= MOST_STATES:
            told = f"it holds {joined_names(states)}"
            out.append(
                f"# keep = [{{ column = {_toml_literal(columns.key(name))}, equals = {_toml_literal(states[0])} }}]   # {told}"
            )
    return ["", "[rows]", *out] if out else []


def _good_first(state: str) -> tuple[bool, str]:
    return state.lower() not in ("ok", "good", "true", "valid", "gut", "i.o.", "yes", "ja"), state


def _toml_literal(value: str | int) -> str:
    return str(value) if isinstance(value, int) else json.dumps(value, ensure_ascii=False)


def inspect(path: Path, hints: Hints = NO_HINTS) -> Document:
    """Understand a file by its content; ``problems`` say what would be refused, ``warnings`` what to look at.

    ``ready`` says whether ``kilter upload`` takes it without a map, ``device`` as what.

    Raises:
        FileError: the file cannot be read at all, with place and remedy.

    """
    found = describe(path, hints)
    size = path.stat().st_size if path.is_file() else sum(file.stat().st_size for file in path.iterdir())
    return {"file": str(path), "size_bytes": size} | found
