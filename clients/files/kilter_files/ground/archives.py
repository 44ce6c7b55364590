"""Zip archives, as workbooks are: what is in one and how much it unpacks to, looked at before anything is unpacked."""

from __future__ import annotations

import zipfile
from pathlib import Path


def unpacked_bytes(path: Path) -> int:
    """Return how many bytes an archive says that it unpacks to.

    Raises:
        ValueError: it cannot be read as one; its text says why.

    """
    return sum(item.file_size for item in _member_infos(path))


def member_names(path: Path) -> list[str]:
    """Return the names in an archive; those of folders end in a slash.

    Raises:
        ValueError: it cannot be read as one; its text says why.

    """
    return [item.filename for item in _member_infos(path)]


def _member_infos(path: Path) -> list[zipfile.ZipInfo]:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.infolist()
    except (OSError, NotImplementedError, zipfile.BadZipFile) as error:  # a zip of a version nobody has yet
        raise ValueError(str(error)) from error
