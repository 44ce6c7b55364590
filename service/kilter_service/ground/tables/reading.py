"""Uploaded bytes into a table of float64 columns, strictly: every refusal names the row and the column.

Rows count from 1, without the header.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from kilter_core.errors import ObservationError
from kilter_files.ground.later import csv as arrow
from kilter_files.ground.later import pa, parquet, pc
from kilter_service.contract.columns import NAMED
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import (
    BATCH_CELLS,
    MAX_CELL,
    MAX_CELLS,
    MAX_COLUMNS,
    MAX_HEADER_BYTES,
    MAX_JSON_BYTES,
    MAX_LINE_BYTES,
)
from kilter_service.ground.tables.columns import check_names
from kilter_service.ground.tables.parquet_pages import check_pages

if TYPE_CHECKING:
    from pyarrow.parquet import FileMetaData, ParquetFile

PIECE_ROWS = 65_536
BUFFER_BYTES = 1 << 20


def parquet_names(path: Path) -> list[str]:
    """Return the names of the columns.

    Raises:
        ObservationError: not a Parquet file, too many columns, or invalid names.

    """
    with _open_parquet(path) as file:
        return list(file.schema_arrow.names)


def parquet_tables(path: Path, named: Names) -> Iterator[pa.Table]:
    """Read a file piece by piece as float64.

    Raises:
        ObservationError: other types than numbers, or more than may be decoded.

    """
    with _open_parquet(path) as file:
        _check_size(file.metadata)
        columns = file.schema_arrow.names
        schema = pa.schema([(name, pa.string() if name in named else pa.float64()) for name in columns])
        rows = max(1, min(PIECE_ROWS, BATCH_CELLS // len(columns)))
        with _translate_arrow_errors():
            for batch in file.iter_batches(batch_size=rows, use_threads=False):
                yield pa.Table.from_batches([batch]).cast(schema)


@contextmanager
def _open_parquet(path: Path) -> Iterator[ParquetFile]:
    check_pages(path)
    with _translate_arrow_errors():
        file = parquet.ParquetFile(path, buffer_size=BUFFER_BYTES)
    with file:
        if file.metadata.num_columns > MAX_COLUMNS:
            raise ObservationError(
                f"The upload has {file.metadata.num_columns} columns, at most {MAX_COLUMNS} are allowed."
            )
        with _translate_arrow_errors():
            schema = file.schema_arrow
            names = schema.names
        _numeric(schema)
        check_names(names)
        yield file


@contextmanager
def _translate_arrow_errors() -> Iterator[None]:
    """Put an error of Arrow into Kilter's words."""
    try:
        yield
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        said = str(error)[:300].rstrip(". ")
        raise ObservationError(
            f"The upload is not a Parquet file that can be read: {said}. Write the file anew, to its end, and send it again."
        ) from error


def _check_size(stated: FileMetaData) -> None:
    if not stated.num_columns:
        raise ObservationError("The upload has no columns.")
    if stated.num_rows * stated.num_columns > MAX_CELLS:
        raise ObservationError(
            f"The upload has {stated.num_rows} rows of {stated.num_columns} columns, more than {MAX_CELLS} cells: split it."
        )


def _numeric(schema: pa.Schema) -> None:
    for field in schema:
        text = field.name in NAMED and (pa.types.is_string(field.type) or pa.types.is_large_string(field.type))
        if not (text or pa.types.is_integer(field.type) or pa.types.is_floating(field.type)):
            raise ObservationError(
                f"Column {field.name[:64]!r} is {str(field.type)[:64]}, not numbers. Send a column for each number, named as "
                "in the reference of observations; files of other programs (a data set of LeRobot) become such columns by "
                "`kilter measure match`, `kilter measure see` or `kilter upload`.",
                column=field.name[:64],
            )


CSV = "text/csv"
PARQUET = "application/vnd.apache.parquet"
JSON = "application/json"
MEDIA_TYPES = (CSV, PARQUET, JSON)

BLOCK_BYTES = 8 << 20
HUGE_BITS = 1023  # of a whole number beyond the doubles
# Each digit has one place in it only, or a cell of many digits would be tried in all ways to split it.
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def media_type(header: str | None) -> str:
    """Return the media type of a request's content-type header.

    Raises:
        ServiceError: Kilter does not read it.

    """
    plain = (header or "").partition(";")[0].strip().lower()
    if plain in MEDIA_TYPES:
        return plain
    raise ServiceError(
        f"Content-Type {plain or '(none)'} is not read: send {', '.join(MEDIA_TYPES)}.", code="media_type_unsupported"
    )


def column_names(path: Path, media: str) -> list[str]:
    """Return the names of a file's columns.

    Raises:
        ObservationError: not such a file, or names that are empty or appear twice.

    """
    if media == CSV:
        return _header(path)
    if media == PARQUET:
        return parquet_names(path)
    return list(_json(path))


def tables(path: Path, media: str, names: Names | None = None) -> Iterator[pa.Table]:
    """Read a file piece by piece; cells that are empty are null, and ``names`` become their numbers.

    Raises:
        ObservationError: no rows, a ragged row, a cell that is not a finite number.

    """
    named = names or Names({})
    pieces = {CSV: _csv_tables, PARQUET: parquet_tables, JSON: _json_tables}[media](path, named)
    first = 1
    for table in pieces:
        if (first - 1 + table.num_rows) * table.num_columns > MAX_CELLS:
            raise ObservationError(f"The upload has more than {MAX_CELLS} cells: split it.")
        table = named.replace_names_by_numbers(table, first)
        _finite(table, first)
        first += table.num_rows
        if table.num_rows:
            yield table
    if first == 1:
        raise ObservationError("The upload has no rows.")


def whole_table(path: Path, media: str, most_rows: int) -> pa.Table:
    """Read a table at once, and no further than it may go.

    Raises:
        ObservationError: as for an upload, or more rows than that.

    """
    pieces, rows = [], 0
    for piece in tables(path, media):
        rows += piece.num_rows
        if rows > most_rows:
            raise ObservationError(f"The table has more than {most_rows} rows: split it.")
        pieces.append(piece)
    return pa.concat_tables(pieces)


def _csv_tables(path: Path, named: Names) -> Iterator[pa.Table]:
    columns = _header(path)
    try:
        reader = arrow.open_csv(
            path,
            read_options=arrow.ReadOptions(
                use_threads=False, block_size=BLOCK_BYTES, column_names=columns, skip_rows=1
            ),
            parse_options=arrow.ParseOptions(ignore_empty_lines=False),
            convert_options=arrow.ConvertOptions(
                column_types={c: pa.string() if c in named else pa.float64() for c in columns},
                null_values=[""],
                strings_can_be_null=True,
            ),
        )
        for batch in reader:
            yield pa.Table.from_batches([batch])
    except pa.ArrowInvalid as error:
        # Arrow is fast, but its errors say too little: the slow reader finds the place.
        _find_fault(path, columns, named)
        raise ObservationError(f"The CSV cannot be read: {str(error)[:300]}.") from error


def _header(path: Path) -> list[str]:
    with path.open("rb") as file:
        first = file.readline(MAX_HEADER_BYTES + 1)
    if len(first) > MAX_HEADER_BYTES:
        raise ObservationError(
            f"The first line of the CSV is longer than {MAX_HEADER_BYTES} bytes: it must name the columns, {MAX_COLUMNS} at "
            "most."
        )
    try:
        text = first.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise ObservationError("The CSV is not UTF-8 text: export it as UTF-8.") from error
    if "\r" in text:
        raise ObservationError(
            "The lines of the CSV end with a carriage return alone: export it with line feeds (in a spreadsheet as CSV, not "
            "as CSV for Macintosh)."
        )
    if ";" in text or "\t" in text:
        raise ObservationError(
            "The CSV separates its columns by ';' or tabs: export it with commas and decimal points, or let a column map "
            "(`--map`) convert it."
        )
    try:
        found = next(csv.reader([text]), [])
    except csv.Error as error:
        raise ObservationError(
            f"The first line of the CSV cannot be read ({error}): it must name the columns."
        ) from error
    if not any(found):
        raise ObservationError("The upload is empty: its first line must name the columns.")
    check_names(found)
    return found


def _find_fault(path: Path, names: Sequence[str], named: Names) -> None:
    number = 0
    with path.open("rb") as file:
        rows = csv.reader(_lines(file))
        try:
            next(rows)
            for number, cells in enumerate(rows, 1):
                _find_fault_in(number, cells, names, named)
        except csv.Error as error:
            raise _cell_error(
                number + 1, None, f"cannot be read ({error}): look for a quotation mark that is not closed"
            ) from error
    if number == 0:
        raise ObservationError("The upload has no rows.")


def _lines(file: io.BufferedReader) -> Iterator[str]:
    for number in itertools.count():
        line = file.readline(MAX_LINE_BYTES + 1)
        if not line:
            return
        if len(line) > MAX_LINE_BYTES:
            raise _cell_error(number, None, f"is longer than {MAX_LINE_BYTES} bytes: end each row with a line break")
        yield line.decode("utf-8-sig" if number == 0 else "utf-8", errors="replace")


def _find_fault_in(number: int, cells: Sequence[str], names: Sequence[str], named: Names) -> None:
    if len(cells) != len(names):
        raise _cell_error(
            number,
            None,
            f"has {len(cells)} cells where the header has {len(names)}: give every row all columns, "
            "and decimal points, not commas",
        )
    for name, cell in zip(names, cells, strict=True):
        if cell and name not in named and (len(cell) > MAX_CELL or not _NUMBER.fullmatch(cell)):
            raise _cell_error(number, name, f"is {cell[:40]!r}, which is not a number: write it like -12.5")


def _json(path: Path) -> dict[str, list[Any]]:
    _check_json(path)
    try:
        document = json.loads(path.read_bytes(), object_pairs_hook=_without_duplicates, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ObservationError(f"The upload is not JSON: {error}.") from error
    if not isinstance(document, dict) or not all(isinstance(column, list) for column in document.values()):
        _not_columns()
    return document


def _check_json(path: Path) -> None:
    """Refuse what would take far more memory than its bytes: many small lists, objects and texts, and many bytes."""
    if path.stat().st_size > MAX_JSON_BYTES:
        raise ServiceError(
            f"JSON columns may have up to {MAX_JSON_BYTES >> 20} MB: send CSV or Parquet.",
            code="upload_too_large",
            limit_mb=MAX_JSON_BYTES >> 20,
        )
    text = path.read_bytes()
    # Lists, objects and texts are counted by what begins them; a few may be there, so that a refusal can name their place.
    if max(text.count(b"["), text.count(b"{"), text.count(b'"') // 2) > 2 * MAX_COLUMNS:
        _not_columns()


def _not_columns() -> NoReturn:
    raise ObservationError(
        f'The JSON must be columns of numbers, at most {MAX_COLUMNS}: {{"q1_deg": [0, 10], "x_mm": [512.1, 498.3]}}.'
    )


def _json_tables(path: Path, named: Names) -> Iterator[pa.Table]:
    document = _json(path)
    longest = max((len(column) for column in document.values()), default=0)
    for name, column in document.items():
        if len(column) != longest:
            raise _cell_error(len(column) + 1, name, "is missing: give every column as many values")
        _cells(name, column, name in named)
    yield pa.table(
        {
            name: pa.array(map(str, column), pa.string(), size=longest)
            if name in named
            else pa.array(map(_float, column), pa.float64(), size=longest)
            for name, column in document.items()
        }
    )


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    check_names([name for name, _ in pairs])
    return dict(pairs)


def _no_constant(name: str) -> float:
    raise ObservationError(f"The JSON holds {name}: leave the row out, or give null for a marker that was not seen.")


def _float(cell: float | None) -> float | None:
    return None if cell is None else float(cell)


def _cells(name: str, column: list[Any], named: bool) -> None:
    for number, cell in enumerate(column, 1):
        if named and isinstance(cell, str):
            continue
        if cell is not None and (isinstance(cell, bool) or not isinstance(cell, int | float)):
            raise _cell_error(number, name, f"is {str(cell)[:40]!r}, which is not a number")
        if isinstance(cell, int) and cell.bit_length() > HUGE_BITS:
            raise _cell_error(number, name, "is too large for a measurement")


def _finite(table: pa.Table, first: int) -> None:
    for name, column in zip(table.column_names, table.columns, strict=True):
        finite = pc.is_finite(column)
        if not pc.all(finite, skip_nulls=True, min_count=0).as_py():
            row = pc.index(finite, False).as_py()
            raise _cell_error(first + row, name, f"is {column[row].as_py()}: leave the row out, or measure it again")


def _cell_error(row: int, column: str | None, what: str) -> ObservationError:
    place = f"Row {row}" if column is None else f"Row {row}, column {column!r}"
    return ObservationError(f"{place} {what}.", row=row, column=column)


class Names:
    """The names that cells of each column may hold; their numbers count from 1. A column may hold the numbers as well."""

    def __init__(self, of: Mapping[str, Sequence[str] | None]) -> None:
        self._of: dict[str, list[str] | None] = {k: None if v is None else list(v) for k, v in of.items()}
        self._met: dict[str, list[str]] = {column: [] for column in self._of}

    @staticmethod
    def from_conditions(conditions: Mapping[str, Any] | None) -> Names:
        """Those that a campaign's conditions name; with None whatever comes."""
        if conditions is None:
            return Names(dict.fromkeys(NAMED))
        return Names({c: [str(one["name"]) for one in conditions.get(k) or ()] for c, k in NAMED.items()})

    def __contains__(self, column: str) -> bool:
        return column in self._of

    def replace_names_by_numbers(self, table: pa.Table, first: int) -> pa.Table:
        """The table with numbers for names; ``first`` is the number of its first row.

        Raises:
            ObservationError: a name that the campaign does not have.

        """
        for place, column in enumerate(table.column_names):
            if column in self._of and pa.types.is_string(table.schema.field(column).type):
                cells = table.column(column).to_pylist()
                numbers = [None if c is None else self._number(column, c, first + k) for k, c in enumerate(cells)]
                table = table.set_column(place, column, pa.array(numbers, pa.float64()))
        return table

    def _number(self, column: str, cell: str, row: int) -> float:
        known = self._of[column]
        text = cell.removesuffix(".0")
        if known is not None and cell in known:
            return float(known.index(cell) + 1)
        if text.isascii() and text.isdigit() and (known is None or 1 <= int(text) <= len(known)):
            return float(text)
        if known is None:
            met = self._met[column]
            if cell not in met:
                met.append(cell)
            return float(met.index(cell) + 1)
        named = ", ".join(known) or "none"
        raise ObservationError(
            f"Row {row}, column {column!r} is {cell[:64]!r}, and the campaign names {named}: correct the cell, or name it in "
            f"the campaign's conditions ({NAMED[column]}).",
            code=f"{column}_unknown",
            row=row,
            column=column,
        )
