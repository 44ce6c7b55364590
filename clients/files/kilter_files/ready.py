"""What a command does with a file: look at it, draft its map, make it ready for upload, read its joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote
from typing import Any

from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.opening import open_source
from kilter_files.formats.points.tracker_header import PRESETS
from kilter_files.formats.reader import DEVICE, MAP, Hints, LogHints
from kilter_files.formats.registry import readers_for, recognised
from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import np
from kilter_files.ground.units import unit_of
from kilter_files.look import draft as drafts
from kilter_files.look import inspection
from kilter_files.maps.column_map import read_map
from kilter_files.maps.mapped import contract_table, further_files, mapped
from kilter_files.rig.points import prepare_points
from kilter_files.tables.joint_log import JointLog, checked_log
from kilter_files.tables.source import Layout
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, PARQUET_TYPE, Prepared, Table


def devices() -> Mapping[str, Callable[[Path], Table]]:
    """Return the reader of each device's files, by name."""
    return {name: reader.read for name, reader in readers_for(DEVICE).items()}


TYPES = {".csv": CSV_TYPE, ".parquet": PARQUET_TYPE, ".json": JSON_TYPE}


def prepare(
    path: Path | str,
    device: str | None = None,
    column_map: Path | str | None = None,
    joined: Path | str | None = None,
    *,
    preset: str | None = None,
    euler: str | None = None,
    hints: LogHints | None = None,
) -> Prepared:
    """Read a file for upload: through its map, else by its preset or its device, else byte for byte as it is.

    ``joined`` is the second file of a map with a table [join], or the joints of the points of a ``preset``; ``hints`` are
    of these joints, and ``euler`` is the order of the preset's angles. A workbook of contract columns needs no map.

    Raises:
        FileError: the file, or the map, is not what it should be; the message names place and remedy.
        MissingPackageError: the format needs the extra ``files``.

    """
    path, other = Path(path), None if joined is None else Path(joined)
    if column_map is not None and (preset or euler):
        raise UsageError("A preset and the order of its angles belong to an export of points, without a column map.")
    if column_map is not None:
        return Prepared.from_table(_mapped(path, Path(column_map), other))
    preset = preset or preset_of(device, path, joined=other is not None)
    if preset is not None:
        return _points(path, preset, euler, other, hints)
    if other is not None:
        raise FileError(f"{other}: a second file needs a column map with a table [join] (--map).", file=str(other))

    if path.suffix.lower() in (".xlsx", ".xlsm"):
        return Prepared.from_table(read_contract(path))
    reader = readers_for(DEVICE).get(device or "")
    if reader is not None and not _is_joined(path):
        return Prepared.from_table(reader.read(path))
    return as_it_is(path)


def preset_of(device: str | None, path: Path, joined: bool = False) -> str | None:
    """Return the preset that a device names, where its file is an export of points and not contract columns already."""

    if device not in PRESETS or path.suffix.lower() in (".json", ".parquet"):
        return None
    return device if joined or not recognised(path, "contract-columns") else None


def _points(path: Path, preset: str, euler: str | None, joints: Path | None, hints: LogHints | None) -> Prepared:

    if preset not in PRESETS:
        raise UsageError(f"preset {preset!r}: is not one of {', '.join(PRESETS)}.")
    return prepare_points(path, preset, euler, None if joints is None else read_joints(joints, None, hints))


def inspect(path: Path | str, **said: Any) -> dict[str, Any]:
    """Return how a file is read, before anything is sent: its kind, columns or markers, notes, warnings and problems.

    ``said`` is what the file does not say itself: ``rate_hz``, ``allow_cut``, ``preset``, ``euler``, ``unit``.

    Raises:
        FileError: the file cannot be read at all, with place and remedy.

    """

    return inspection.inspect(Path(path), Hints(**said))


def draft(path: Path | str) -> drafts.Draft:
    """Draft a column map for a file: what names and ranges tell, and marks where they do not.

    Raises:
        FileError: no table of numbers is found in it.

    """

    return drafts.draft(Path(path))


def read_contract(path: Path) -> Table:
    """Read a workbook of contract columns.

    Raises:
        FileError: other columns, or a damaged workbook.

    """

    return contract_table(open_source(path, None, Layout()))


def read_joints(path: Path, column_map: Path | None = None, hints: LogHints | None = None) -> JointLog:
    """Read a joint log: as it is, or any table through its map.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """

    if column_map is None:
        return read_joint_log(path, hints or LogHints())

    table = _mapped(path, column_map, None)
    return checked_log(path, {name: np.array(values) for name, values in table.columns.items()}, table.lines)


def _mapped(path: Path, column_map: Path, joined: Path | None) -> Table:
    """Read a file and those of the map's [join] tables, and return them in contract columns."""

    chosen = read_map(column_map, readers_for(MAP))
    source = open_source(path, chosen.form, chosen.layout)
    places = further_files(path, chosen, joined)
    further = [open_source(place, one.form, one.layout) for place, one in zip(places, chosen.joins, strict=True)]
    return mapped(source, chosen, further)


def _is_joined(path: Path) -> bool:
    """Tell whether a device's log was joined with the joint log already: all of its columns are the contract's."""

    if path.suffix.lower() != ".csv":
        return False
    try:
        with path.open(encoding="utf-8") as stream:
            names = stream.readline(65_536).strip().split(",")
    except (OSError, UnicodeDecodeError):
        return False
    return all(unit_of(name) is not None for name in names)


def as_it_is(path: Path) -> Prepared:
    """Read a file that already has contract columns; its bytes, and so its content hash, stay what they are."""
    kind = TYPES.get(path.suffix.lower())
    if kind is None:
        raise FileError(
            f"{path}: the ending {path.suffix!r} is none of {', '.join((*TYPES, '.xlsx'))}. Send it with a column map "
            f"(--map columns.toml; a first one: `kilter inspect {quote(str(path))} --draft columns.toml`) or name its device "
            f"({', '.join(readers_for(DEVICE))}).",
            file=str(path),
        )
    try:
        return Prepared(path.read_bytes(), kind, notes=("contract columns, sent as they are",))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}.", file=str(path)) from error
