"""How a file is read, before anything is sent: one document for people and programs."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import NO_HINTS, Document, Hints
from kilter_files.formats.registry import describe


def inspect(path: Path, hints: Hints = NO_HINTS) -> Document:
    """Understand a file by its content; ``problems`` say what would be refused, ``warnings`` what to look at.

    ``ready`` says whether ``kilter upload`` takes it without a map, ``device`` as what.

    Raises:
        FileError: the file cannot be read at all, with place and remedy.

    """
    found = describe(path, hints)
    size = path.stat().st_size if path.is_file() else sum(file.stat().st_size for file in path.iterdir())
    return {"file": str(path), "size_bytes": size} | found
