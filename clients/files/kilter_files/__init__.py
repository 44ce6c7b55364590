"""Files of measurements, made ready for upload."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from kilter_files.ground.errors import FileError
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, PARQUET_TYPE, Prepared, Table

if TYPE_CHECKING:
    from kilter_files.formats.joints.joint_log import LogHints
    from kilter_files.tables.joint_log import JointLog

__all__ = ["DEVICES", "Prepared", "prepare", "read_joints"]


def _ipa_lasertracker(path: Path) -> Table:
    """A campaign of Fraunhofer IPA's laser tracker data set."""
    from kilter_files.formats.points.ipa_lasertracker import read_ipa_lasertracker

    return read_ipa_lasertracker(path)


def _ballbar(path: Path) -> Table:
    """The log of a double ball bar."""
    from kilter_files.formats.logs.ballbar import ballbar_table

    return ballbar_table(path)


def _inclinometer(path: Path) -> Table:
    """The log of an inclinometer: no campaign, see `kilter tilt-join`."""
    raise FileError(
        f"{path}: an inclinometer measures joints, not tool positions, so it makes no campaign. See what it holds with "
        "`kilter inspect`, and send readings with `kilter joint-parameters ROBOT --readings FILE`.",
        file=str(path),
    )


# device name -> reader of its files, whose docstring is its line in `kilter formats`; any other device's files must be
# contract columns or come with a map
DEVICES: Mapping[str, Callable[[Path], Table]] = {
    "ballbar": _ballbar,
    "inclinometer": _inclinometer,
    "ipa-lasertracker": _ipa_lasertracker,
}

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
    from kilter_files.formats.tables.source import endings

    if endings().get(path.suffix.lower()) == "xlsx":
        return Prepared.from_table(read_contract(path))
    if device is not None and device in DEVICES and not _is_joined(path):
        return Prepared.from_table(DEVICES[device](path))
    return as_it_is(path)


def read_contract(path: Path) -> Table:
    """Read a workbook of contract columns.

    Raises:
        FileError: other columns, or a damaged workbook.

    """
    from kilter_files.formats.tables.source import open_source
    from kilter_files.maps.mapped import contract_table
    from kilter_files.tables.source import Layout

    return contract_table(open_source(path, None, Layout()))


def read_joints(path: Path, column_map: Path | None = None, hints: LogHints | None = None) -> JointLog:
    """Read a joint log: as it is, or any table through its map.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """
    from kilter_files.formats.joints.joint_log import LogHints, read_joint_log

    if column_map is None:
        return read_joint_log(path, hints or LogHints())
    import numpy as np

    from kilter_files.tables.joint_log import checked_log

    table = _mapped(path, column_map, None)
    return checked_log(path, {name: np.array(values) for name, values in table.columns.items()}, table.lines)


def _mapped(path: Path, column_map: Path, joined: Path | None) -> Table:
    """Read a file and, where the map has a [join], the second one, and return them in contract columns."""
    from kilter_files.formats.tables.source import FORMATS, open_source
    from kilter_files.maps.column_map import read_map
    from kilter_files.maps.mapped import mapped, second_file

    chosen = read_map(column_map, FORMATS)
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
        raise FileError(
            f"{path}: the ending {path.suffix!r} is none of {', '.join((*TYPES, '.xlsx'))}. Send it with a column map "
            f"(--map columns.toml; a first one: `kilter inspect {quote(str(path))} --draft columns.toml`) or name its device "
            f"({', '.join(DEVICES)}).",
            file=str(path),
        )
    try:
        return Prepared(path.read_bytes(), kind, notes=("contract columns, sent as they are",))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}.", file=str(path)) from error
