"""Errors of files: where, what, and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError

CUT = "Copy or export it again. If it was recorded like that, allow_cut (--allow-cut) uses the complete frames."


def fault(path: Path, what: str, remedy: str, **place: Any) -> FileError:
    """Build the error of a file; ``place`` is any of line, frame, column, byte."""
    named = [f"{key} {value!r}" if key == "column" else f"{key} {value}" for key, value in place.items()]
    return FileError(f"{', '.join([str(path), *named])}: {what}. {remedy}", file=str(path), **place)


def read_head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file.

    Raises:
        FileError: it cannot be read.

    """
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}.", file=str(path)) from error
