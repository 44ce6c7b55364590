"""The one list of formats that a column map takes, and their readers.

A new format is one more line in ``FORMATS`` and a module with its reader.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from kilter_files.ground.errors import FileError
from kilter_files.tables.source import Layout, Source


@dataclass(frozen=True)
class Format:
    """A format: what it is for people, the endings it is known by, and its reader, which imports what it needs when called."""

    title: str
    endings: tuple[str, ...]
    read: Callable[[Path, Layout], Source]


def _csv(path: Path, layout: Layout) -> Source:
    from kilter_files.formats.tables.text import read_text

    return read_text(path, layout)


def _mat(path: Path, layout: Layout) -> Source:
    from kilter_files.formats.tables.mat import read_mat

    return read_mat(path, _missing(layout))


def _parquet(path: Path, layout: Layout) -> Source:
    from kilter_files.formats.tables.parquet import read_parquet

    return read_parquet(path, _missing(layout))


def _tdms(path: Path, layout: Layout) -> Source:
    from kilter_files.formats.tables.tdms_columns import read_tdms

    return read_tdms(path, _missing(layout))


def _xlsx(path: Path, layout: Layout) -> Source:
    from kilter_files.formats.tables.workbook import read_xlsx

    return read_xlsx(path, layout)


def _program(path: Path, layout: Layout) -> Source:
    from kilter_files.formats.tables.program import read_program

    return read_program(path, layout)


FORMATS: dict[str, Format] = {
    "csv": Format("delimited text", (".csv", ".txt", ".tsv", ".dat"), _csv),
    "mat": Format("MATLAB, up to version 7", (".mat",), _mat),
    "parquet": Format("Parquet", (".parquet",), _parquet),
    "tdms": Format("LabVIEW's TDMS", (".tdms",), _tdms),
    "xlsx": Format("a sheet of a workbook", (".xlsx", ".xlsm"), _xlsx),
    "program": Format("joint targets of a robot program", (".mod", ".src", ".ls", ".script"), _program),
}


def endings() -> Mapping[str, str]:
    """Return the format of every known ending."""
    return {ending: name for name, form in FORMATS.items() for ending in form.endings}


def open_source(path: Path, form: str | None, layout: Layout) -> Source:
    """Read ``path`` in ``form`` (a key of ``FORMATS``; None: by the file's ending).

    Raises:
        FileError: an ending that says nothing, or a file its reader refuses.

    """
    form = form or _by_content(path) or endings().get(path.suffix.lower())
    if form is None:
        raise FileError(
            f"{path}: the ending {path.suffix!r} names no known format. "
            f"Set 'format' under [file] to one of {', '.join(FORMATS)}.",
            file=str(path),
        )
    return FORMATS[form].read(path, layout)


def _by_content(path: Path) -> str | None:
    """KUKA's data lists end in .dat, and programs are sent as .txt: what they hold tells them from tables."""
    if path.suffix.lower() not in (".dat", ".txt"):
        return None
    from kilter_files.formats.programs.targets import dialect_of

    return "program" if dialect_of(path) is not None else None


def _missing(layout: Layout) -> tuple[float, ...]:
    return tuple(value for value in layout.missing if isinstance(value, float))
