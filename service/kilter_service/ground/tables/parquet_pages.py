"""How large the pages of a Parquet file become, read from the pages themselves before anything is decoded.

A page is unpacked whole, and the sizes in the footer may be wrong; the header before each page is what a reader follows.
The footer is read here as well: where it is damaged, pyarrow's own view of a column chunk ends the process.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from kilter_core.errors import ObservationError
from kilter_service.ground.limits import MAX_FOOTER_BYTES, MAX_PAGES, MAX_PAGES_BYTES

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12
DEEPEST = 12
FIXED = {BYTE: 1, DOUBLE: 8}


class Thrift:
    """Reads one struct after another from bytes; damaged ones raise ValueError or IndexError."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Fields by number: integers, structs and lists; what else there is, is passed over and None."""
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            fields[number] = kind == TRUE if kind in (TRUE, FALSE) else self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError("nested too deeply")
        if kind in (I16, I32, I64):
            return self._integer()
        if kind == STRUCT:
            return self.struct(depth + 1)
        if kind in (LIST, SET):
            return self._list(depth)
        if kind not in (TRUE, FALSE, BYTE, DOUBLE, BINARY):
            raise ValueError(f"a field of type {kind}")
        size = 1 if kind in (TRUE, FALSE) else FIXED.get(kind) or self._varint()
        self.at += size
        if self.at > len(self.data):
            raise ValueError("cut off")
        return None

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        size = self._varint() if head >> 4 == 15 else head >> 4
        if size > len(self.data) - self.at:
            raise ValueError("a list longer than its bytes")
        return [self._value(head & 15, depth + 1) for _ in range(size)]

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


MAGIC = b"PAR1"
HEADER_BYTES = 1 << 16  # of a page; statistics in it are short for numbers
DATA_PAGE, DICTIONARY_PAGE, DATA_PAGE_V2 = 0, 2, 3
REMEDY = "Write it with a data page size of about a megabyte, or split it"
# Field numbers of the Parquet format: PageHeader and the headers in it,
TYPE, UNPACKED, PACKED, VALUES = 1, 2, 3, 1
HEADER_OF = {DATA_PAGE: 5, DICTIONARY_PAGE: 7, DATA_PAGE_V2: 8}
# FileMetaData, RowGroup, ColumnChunk, ColumnMetaData.
GROUPS, COLUMNS, ABOUT = 4, 1, 3
CHUNK_VALUES, CHUNK_BYTES, FIRST_PAGE, DICTIONARY = 5, 7, 9, 11
DAMAGED = (IndexError, KeyError, TypeError, ValueError, AttributeError)


class Chunk(NamedTuple):
    """A column of a row group: where its pages are in the file, and how many values it states."""

    column: int
    start: int
    end: int
    values: int


class Page(NamedTuple):
    """One page: its kind, its bytes in the file with the header, its bytes unpacked, its values."""

    kind: int
    size: int
    unpacked: int
    values: int


def check_pages(path: Path) -> None:
    """Refuse a file that would fill the memory by its footer or by the pages that are unpacked together.

    Raises:
        ObservationError: too large or too many, other values than stated, or damaged. The reader refuses what is not a
            Parquet file.

    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        footer = _footer(file, size)
        if footer is None:
            return
        counted = 0
        for group in _groups(footer, size):
            together = 0
            for chunk in group:
                largest, pages = _largest(file, chunk, MAX_PAGES - counted)
                together, counted = together + largest, counted + pages
                if together > MAX_PAGES_BYTES:
                    raise ObservationError(
                        f"The pages of the Parquet file unpack to more than {MAX_PAGES_BYTES >> 20} MB at once. {REMEDY}."
                    )


def _footer(file: BinaryIO, size: int) -> bytes | None:
    if size < 12:
        return None
    file.seek(-8, 2)
    length, magic = int.from_bytes(file.read(4), "little"), file.read(4)
    if magic != MAGIC or length + 12 > size:
        return None
    if length > MAX_FOOTER_BYTES:
        raise ObservationError(
            f"The Parquet file describes itself in {length} bytes, at most {MAX_FOOTER_BYTES} are allowed: write fewer "
            "row groups."
        )
    file.seek(-8 - length, 2)
    return file.read(length)


def _groups(footer: bytes, size: int) -> Iterator[list[Chunk]]:
    try:
        groups = Thrift(footer).struct().get(GROUPS, [])
        found = [[_chunk(k, column[ABOUT], size) for k, column in enumerate(group[COLUMNS])] for group in groups]
    except DAMAGED as error:
        raise ObservationError(f"The Parquet file's footer is damaged ({error}): write the file again.") from error
    yield from found


def _chunk(k: int, about: dict[int, Any], size: int) -> Chunk:
    start = min(about[FIRST_PAGE], about.get(DICTIONARY) or about[FIRST_PAGE])
    end = start + about[CHUNK_BYTES]
    if not 0 < start <= end <= size:
        raise ValueError("pages outside the file")
    return Chunk(k, start, end, int(about[CHUNK_VALUES]))


def _largest(file: BinaryIO, chunk: Chunk, most_pages: int) -> tuple[int, int]:
    """Bytes in memory while a column is read, its dictionary and its largest page; and how many pages it has."""
    largest, values, count = {True: 0, False: 0}, 0, 0
    for page in _pages(file, chunk):
        count += 1
        if count > most_pages:
            raise ObservationError(f"The Parquet file has more than {MAX_PAGES} pages. {REMEDY}.")
        is_dictionary = page.kind == DICTIONARY_PAGE
        values += 0 if is_dictionary else page.values
        largest[is_dictionary] = max(largest[is_dictionary], page.unpacked)
    if values != chunk.values:
        raise ObservationError(
            f"Column {chunk.column + 1} of the Parquet file states {chunk.values} values and has {values}: "
            "write the file again."
        )
    return sum(largest.values()), count


def _pages(file: BinaryIO, chunk: Chunk) -> Iterator[Page]:
    at = chunk.start
    while at < chunk.end:
        file.seek(at)
        page = _page(file.read(HEADER_BYTES), chunk.column)
        yield page
        at += page.size


def _page(data: bytes, column: int) -> Page:
    reader = Thrift(data)
    try:
        fields = reader.struct()
        kind, packed, unpacked = fields[TYPE], fields[PACKED], fields[UNPACKED]
        values = fields[HEADER_OF[kind]][VALUES] if kind in HEADER_OF else 0
        if min(packed, unpacked, values) < 0:
            raise ValueError("a negative size")
    except DAMAGED as error:
        raise ObservationError(
            f"Column {column + 1} of the Parquet file has a page that cannot be read ({error}): write the file again."
        ) from error
    return Page(kind, reader.at + packed, unpacked, values)
