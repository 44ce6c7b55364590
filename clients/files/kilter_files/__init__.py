"""Files of measurements, made ready for upload."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from kilter_files.ground.errors import FileError
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, PARQUET_TYPE, Prepared, Table

if TYPE_CHECKING:
    from kilter_files.formats.reader import LogHints
    from kilter_files.tables.joint_log import JointLog

    DEVICES: Mapping[str, Callable[[Path], Table]]

__all__ = ["DEVICES", "Prepared", "prepare", "read_joints"]


def __getattr__(name: str) -> Any:
    """``DEVICES``: the reader of each device's files, by name, gathered from the readers when it is asked for."""
    if name != "DEVICES":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from kilter_files.formats.reader import DEVICE
    from kilter_files.formats.registry import readers_for

    return {name: reader.read for name, reader in readers_for(DEVICE).items()}


TYPES = {".csv": CSV_TYPE, ".parquet": PARQUET_TYPE, ".json": JSON_TYPE}


def prepare(
    path: Path | str,
    device: str | None = None,
    column_map: Path | str | None = None,
    joined: Path | str | None = None,
) -> Prepared:
    """Read a file for upload: through its map, else through the device's importer, else byte for byte as it is.

    ``joined`` is the second file of a map with a table [join]. A workbook of contract columns needs no map.

    Raises:
        FileError: the file, or the map, is not what it should be; the message names place and remedy.
        MissingPackageError: the format needs the extra ``files``.

    """
    path = Path(path)
    if column_map is not None:
        return Prepared.from_table(_mapped(path, Path(column_map), None if joined is None else Path(joined)))
    if joined is not None:
        raise FileError(f"{joined}: a second file needs a column map with a table [join] (--map).", file=str(joined))
    from kilter_files.formats.opening import endings

    if endings().get(path.suffix.lower()) == "xlsx":
        return Prepared.from_table(read_contract(path))
    from kilter_files.formats.reader import DEVICE
    from kilter_files.formats.registry import readers_for

    reader = readers_for(DEVICE).get(device or "")
    if reader is not None and not _is_joined(path):
        return Prepared.from_table(reader.read(path))
    return as_it_is(path)


def read_contract(path: Path) -> Table:
    """Read a workbook of contract columns.

    Raises:
        FileError: other columns, or a damaged workbook.

    """
    from kilter_files.formats.opening import open_source
    from kilter_files.maps.mapped import contract_table
    from kilter_files.tables.source import Layout

    return contract_table(open_source(path, None, Layout()))


def read_joints(path: Path, column_map: Path | None = None, hints: LogHints | None = None) -> JointLog:
    """Read a joint log: as it is, or any table through its map.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """
    from kilter_files.formats.joints.joint_log import read_joint_log
    from kilter_files.formats.reader import LogHints

    if column_map is None:
        return read_joint_log(path, hints or LogHints())
    import numpy as np

    from kilter_files.tables.joint_log import checked_log

    table = _mapped(path, column_map, None)
    return checked_log(path, {name: np.array(values) for name, values in table.columns.items()}, table.lines)


def _mapped(path: Path, column_map: Path, joined: Path | None) -> Table:
    """Read a file and, where the map has a [join], the second one, and return them in contract columns."""
    from kilter_files.formats.opening import open_source
    from kilter_files.formats.reader import MAP
    from kilter_files.formats.registry import readers_for
    from kilter_files.maps.column_map import read_map
    from kilter_files.maps.mapped import mapped, second_file

    chosen = read_map(column_map, readers_for(MAP))
    source = open_source(path, chosen.form, chosen.layout)
    place = second_file(path, chosen, joined)
    there = None if place is None or chosen.join is None else open_source(place, chosen.join.form, chosen.join.layout)
    return mapped(source, chosen, there)


def _is_joined(path: Path) -> bool:
    """Tell whether a device's log was joined with the joint log already: all of its columns are the contract's."""
    from kilter_files.ground.units import unit_of

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
        from kilter_files.formats.reader import DEVICE
        from kilter_files.formats.registry import readers_for

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
