"""Files of measurements, made ready for upload."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import later, np
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, PARQUET_TYPE, Prepared, Table

if TYPE_CHECKING:
    from kilter_files.formats.reader import LogHints
    from kilter_files.look.drafts import Draft
    from kilter_files.tables.table import JointLog

    DEVICES: Mapping[str, Callable[[Path], Table]]

with later(__name__):
    from kilter_files.formats import marker_header, reader, registry
    from kilter_files.formats.joints import joint_log
    from kilter_files.ground import units
    from kilter_files.look import drafts
    from kilter_files.maps import column_map as column_maps
    from kilter_files.maps import mapped
    from kilter_files.rig import tilt_join
    from kilter_files.tables import source
    from kilter_files.tables import table as joint_logs

__all__ = ["DEVICES", "Prepared", "draft", "has_contract_header", "inspect", "prepare", "read_joints"]


def __getattr__(name: str) -> Any:
    """``DEVICES``: the reader of each device's files, by name, gathered from the readers when it is asked for."""
    if name != "DEVICES":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return {name: one.read for name, one in registry.readers_for(reader.DEVICE).items()}


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
        UsageError: something is said that would do nothing with this file.
        MissingPackageError: the format needs the extra ``files``.

    """
    path, other = Path(path), None if joined is None else Path(joined)
    if column_map is None:
        preset = preset or (_preset_for_device(device, path, joined=other is not None) if device else None)
    said = euler or (hints is not None and (hints.topic or hints.order))
    if (said and preset is None) or (column_map is not None and (preset or said)):
        raise UsageError(
            "A preset, the order of its angles and the topic or order of its joints (--preset, --euler, --topic, "
            "--joint-order) belong to a text export of points, without a column map."
        )
    if other is not None and preset is None and column_map is None:
        raise UsageError(
            f"{other}: a second file (--joints) goes with a preset (--preset: a text export of points) or with a column map "
            "that has a table [join] (--map)."
        )
    if preset is None and column_map is None and path.suffix.lower() not in (".xlsx", ".xlsm"):
        by_device = registry.readers_for(reader.DEVICE).get(device) if device else None
        if by_device is None or has_contract_header(path):
            return as_it_is(path)
        table = by_device.read(path)
    elif preset is not None:
        table = tilt_join.read_points(path, preset, euler, other, hints)
    else:
        table = _read_with_map(path, None if column_map is None else Path(column_map), other)
    return Prepared.from_table(table)


def _preset_for_device(device: str, path: Path, joined: bool) -> str | None:
    """Return the preset that a device names, where its file is an export of points and not contract columns already."""
    if device not in marker_header.PRESETS or path.suffix.lower() in (".json", ".parquet"):
        return None
    return device if joined or not registry.has_format(path, "contract-columns") else None


def inspect(path: Path | str, **said: Any) -> dict[str, Any]:
    """Return how a file is read, before anything is sent: its kind, columns or markers, notes, warnings and problems.

    ``said`` is what the file does not say itself: ``rate_hz``, ``allow_cut``, ``preset``, ``euler``, ``unit``.

    Raises:
        FileError: the file cannot be read at all, with place and remedy.

    """
    return drafts.inspect(Path(path), reader.Hints(**said))


def draft(path: Path | str, robot: Sequence[str] = ()) -> Draft:
    """Draft a column map for a file: what names and ranges tell, and marks where they do not.

    ``robot`` are the joints of the arm, from base to tool; prismatic ones end in ``:m``.

    Raises:
        FileError: no table of numbers is found in it.

    """
    return drafts.draft(Path(path), robot)


def read_joints(path: Path, column_map: Path | None = None, hints: LogHints | None = None) -> JointLog:
    """Read a joint log: as it is, or any table through its map.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """
    if column_map is None:
        return joint_log.read_joint_log(path, hints or reader.LogHints())
    table = _read_with_map(path, column_map, None)
    return joint_logs.checked_log(path, {name: np.array(values) for name, values in table.columns.items()}, table.lines)


def _read_with_map(path: Path, column_map: Path | None, joined: Path | None) -> Table:
    """Read a file and those of the map's [join] tables into contract columns; without a map it has these already."""
    if column_map is None:
        first = registry.open_source(path, None, source.Layout())
        chosen = column_maps.contract_map(first)
    else:
        chosen = column_maps.read_map(column_map, registry.readers_for(reader.MAP))
        first = registry.open_source(path, chosen.form, chosen.layout)
    places = column_maps.further_files(path, chosen.joins, chosen.path, joined)
    others = [
        registry.open_source(place, one.form, one.layout) for place, one in zip(places, chosen.joins, strict=True)
    ]
    return mapped.apply_column_map(first, chosen, others)


def has_contract_header(path: Path) -> bool:
    """Tell whether all columns of a CSV file are the contract's, as of a device's log that was joined with its joints."""
    if path.suffix.lower() != ".csv":
        return False
    try:
        with path.open(encoding="utf-8") as stream:
            names = stream.readline(65_536).strip().split(",")
    except (OSError, UnicodeDecodeError):
        return False
    return all(units.column_unit(name) is not None for name in names)


def as_it_is(path: Path) -> Prepared:
    """Read a file that already has contract columns; its bytes, and so its content hash, stay what they are."""
    kind = TYPES.get(path.suffix.lower())
    if kind is None:
        registry.binary_reader(reader.Head(path))  # what holds no rows at all, an archive or a picture, says so
        raise FileError(
            f"{path}: the ending {path.suffix!r} is none of {', '.join((*TYPES, '.xlsx'))}. Send it with a column map "
            f"(--map columns.toml; a first one: `kilter measure inspect {quote(str(path))} --draft columns.toml`) or "
            "name its device "
            f"({', '.join(registry.readers_for(reader.DEVICE))}).",
            file=str(path),
        )
    if kind == JSON_TYPE and registry.has_format(path, "json"):
        raise FileError(
            f"{path}: holds a list of poses, not contract columns. Send it with a column map (--map columns.toml; a first "
            f"one: `kilter measure inspect {quote(str(path))} --draft columns.toml`).",
            file=str(path),
        )
    try:
        return Prepared(path.read_bytes(), kind, notes=("its columns are sent as they are",))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}.", file=str(path)) from error
