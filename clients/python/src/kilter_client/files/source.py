"""What every readable file offers a column map, and which reader a format has."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from kilter_client.errors import FileError
from kilter_client.files.source_mat import read_mat
from kilter_client.files.source_parquet import read_parquet
from kilter_client.files.source_text import Layout, read_text

FORMATS = ("csv", "mat", "parquet", "tdms")
ENDINGS = {".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".mat": "mat"}
ENDINGS |= {".parquet": "parquet", ".tdms": "tdms"}


class Source(Protocol):
    """A file as columns by name."""

    @property
    def lines(self) -> list[int]:
        """The line of each row; empty when rows have none."""

    def texts(self, name: str | int) -> list[str]:
        """Return a column as text."""

    def numbers(self, name: str | int) -> list[float]:
        """Return a column as numbers, NaN where nothing was measured."""


def open_source(path: Path, form: str | None, layout: Layout) -> Source:
    """Read ``path`` in ``form`` ("csv", "mat", "parquet", "tdms"; None: by the file's ending).

    Raises:
        FileError: an ending that says nothing, or a file its reader refuses.

    """
    form = form or ENDINGS.get(path.suffix.lower())
    numbers = tuple(value for value in layout.missing if isinstance(value, float))
    if form == "mat":
        return read_mat(path, numbers)
    if form == "parquet":
        return read_parquet(path, numbers)
    if form == "tdms":
        from kilter_client.files.source_tdms import read_tdms  # its reader needs numpy, which maps of text do not

        return read_tdms(path, numbers)
    if form == "csv":
        return read_text(path, layout)
    raise FileError(
        f"{path}: the ending {path.suffix!r} names no known format. "
        f"Set 'format' under [file] to one of {', '.join(FORMATS)}.",
        file=str(path),
    )
