"""The text of a robot file."""

from __future__ import annotations

from pathlib import Path

from kilter_files.ground.errors import FileError


def read_text(path: Path) -> str:
    """Return a file's text, with or without a byte order mark.

    Raises:
        FileError: it is not text.

    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read as text ({error}).", file=str(path)) from error
