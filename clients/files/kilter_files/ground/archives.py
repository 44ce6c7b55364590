"""Zip archives, as workbooks are: how much one unpacks to, looked at before anything is unpacked."""

from __future__ import annotations

import zipfile
from pathlib import Path


def unpacked_bytes(path: Path) -> int:
    """Return how many bytes an archive says that it unpacks to.

    Raises:
        ValueError: it cannot be read as one; its text says why.

    """
    try:
        with zipfile.ZipFile(path) as archive:
            return sum(item.file_size for item in archive.infolist())
    except (OSError, NotImplementedError, zipfile.BadZipFile) as error:  # a zip of a version nobody has yet
        raise ValueError(str(error)) from error
