"""Opens a file by its reader: a table for a column map, or a recording of markers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.reader import MAP, Head, Hints, RecordingReader
from kilter_files.formats.registry import all_readers, binary_reader, has_format, readers_for
from kilter_files.ground.errors import FileError, fault
from kilter_files.tables.source import Layout, Source

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording


def endings() -> Mapping[str, str]:
    """Return the format of every known ending of a table."""
    return {ending: name for name, reader in readers_for(MAP).items() for ending in reader.endings}


def open_source(path: Path, form: str | None, layout: Layout) -> Source:
    """Read ``path`` in ``form`` (the name of a reader; None: by the file's ending).

    Raises:
        FileError: an ending that says nothing, or a file its reader refuses.

    """
    form = form or _by_content(path) or endings().get(path.suffix.lower())
    if form is None:
        raise FileError(
            f"{path}: the ending {path.suffix!r} names no known format. "
            f"Set 'format' under [file] to one of {', '.join(readers_for(MAP))}.",
            file=str(path),
        )
    found: Source = readers_for(MAP)[form].read(path, Hints(layout=layout))
    return found


def _by_content(path: Path) -> str | None:
    """KUKA's data lists end in .dat, and programs are sent as .txt: what they hold tells them from tables."""
    return "program" if path.suffix.lower() in (".dat", ".txt") and has_format(path, "program") else None


def open_recording(
    path: Path, rate_hz: float | None = None, allow_cut: bool = False, unit: str | None = None
) -> Recording:
    """Read a recording of markers or tools: C3D, NDI floating point, or text; ``unit`` overrides what the file states.

    Raises:
        FileError: the file of another device, or a damaged one.

    """
    reader = binary_reader(Head(path)) or all_readers()["text"]
    if not isinstance(reader, RecordingReader):
        raise fault(path, f"is {reader.is_a}, not a recording of markers", reader.instead)
    return reader.read(path, Hints(rate_hz, allow_cut, unit=unit))
