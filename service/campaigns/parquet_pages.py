"""How large the pages of a Parquet file become, read from the pages themselves before anything is decoded.

A page is unpacked whole, and the sizes in the footer may be wrong; the header before each page is what a reader follows.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from core.errors import ObservationError
from service.limits import MAX_FOOTER_BYTES, MAX_PAGES, MAX_PAGES_BYTES

if TYPE_CHECKING:
    from pyarrow.parquet import ColumnChunkMetaData

HEADER_BYTES = 1 << 16  # of a page; statistics in it are short for numbers
DATA_PAGE, DICTIONARY_PAGE, DATA_PAGE_V2 = 0, 2, 3
REMEDY = "Write it with a data page size of about a megabyte, or split it"
# Field numbers of PageHeader and of the headers in it, by the Parquet format.
TYPE, UNPACKED, PACKED, VALUES = 1, 2, 3, 1
HEADER_OF = {DATA_PAGE: 5, DICTIONARY_PAGE: 7, DATA_PAGE_V2: 8}


class Page(NamedTuple):
    """One page: its kind, its bytes in the file with the header, its bytes unpacked, its values."""

    kind: int
    size: int
    unpacked: int
    values: int


class _Thrift:
    """Reads a struct of Thrift's compact protocol as far as sizes of pages need it: integers by field number."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Integers and structs by field number; all else is passed over."""
        if depth > 4:
            raise ValueError("nested too deeply")
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            fields[number] = self._value(head & 15, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (1, 2):
            return kind == 1
        if kind in (4, 5, 6):
            return self._integer()
        if kind == 12:
            return self.struct(depth + 1)
        if kind not in (3, 7, 8):
            raise ValueError(f"a field of type {kind}")
        size = {3: 1, 7: 8}.get(kind) or self._varint()
        self.at += size
        return None

    def _byte(self) -> int:
        byte = self.data[self.at]
        self.at += 1
        return byte

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("an endless number")

    def _integer(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)


def check_footer(path: Path) -> None:
    """Refuse a footer that would fill the memory by itself.

    Raises:
        ObservationError: the footer is too large. What is no Parquet file at all the reader says.

    """
    with path.open("rb") as file:
        if file.seek(0, 2) < 8:
            return
        file.seek(-8, 2)
        size = int.from_bytes(file.read(4), "little")
    if size > MAX_FOOTER_BYTES:
        raise ObservationError(
            f"The Parquet file describes itself in {size} bytes, {MAX_FOOTER_BYTES} are taken: write fewer row groups."
        )


class PageRule:
    """Checks the pages of every column chunk of a file and counts them."""

    def __init__(self, path: Path) -> None:
        self._path, self._pages = path, 0

    def check(self, chunks: list[ColumnChunkMetaData]) -> None:
        """Refuse a row group whose pages do not fit in memory together.

        Raises:
            ObservationError: too many or too large pages, other values than stated, or no pages at all.

        """
        together = 0
        with self._path.open("rb") as file:
            for chunk in chunks:
                together += self._largest(file, chunk)
                if together > MAX_PAGES_BYTES:
                    raise ObservationError(
                        f"The pages of the Parquet file unpack to more than {MAX_PAGES_BYTES >> 20} MB at once. {REMEDY}."
                    )

    def _largest(self, file: BinaryIO, chunk: ColumnChunkMetaData) -> int:
        """Bytes in memory while a column is read: its dictionary and its largest page."""
        name, largest, values = chunk.path_in_schema, {True: 0, False: 0}, 0
        for page in _pages(file, chunk):
            self._pages += 1
            if self._pages > MAX_PAGES:
                raise ObservationError(f"The Parquet file has more than {MAX_PAGES} pages. {REMEDY}.", column=name)
            is_dictionary = page.kind == DICTIONARY_PAGE
            values += 0 if is_dictionary else page.values
            largest[is_dictionary] = max(largest[is_dictionary], page.unpacked)
        if values != chunk.num_values:
            raise ObservationError(
                f"Column {name!r} states {chunk.num_values} values and has {values}: write the file anew.", column=name
            )
        return sum(largest.values())


def _pages(file: BinaryIO, chunk: ColumnChunkMetaData) -> Iterator[Page]:
    starts = [start for start in (chunk.dictionary_page_offset, chunk.data_page_offset) if start]
    at = min(starts, default=0)
    end = at + chunk.total_compressed_size
    while at < end:
        file.seek(at)
        page = _page(file.read(HEADER_BYTES), chunk.path_in_schema)
        yield page
        at += page.size


def _page(data: bytes, name: str) -> Page:
    reader = _Thrift(data)
    try:
        fields = reader.struct()
        kind, packed, unpacked = fields[TYPE], fields[PACKED], fields[UNPACKED]
        values = fields[HEADER_OF[kind]][VALUES] if kind in HEADER_OF else 0
        if min(packed, unpacked, values) < 0:
            raise ValueError("a negative size")
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ObservationError(
            f"Column {name!r} has a page that cannot be read ({error}): write the file anew.", column=name
        ) from error
    return Page(kind, reader.at + packed, unpacked, values)
