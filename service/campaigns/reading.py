"""Uploaded bytes into a table of float64 columns, strictly: every refusal names the row and the column.

Rows count from 1, the header is none of them.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from core.errors import ObservationError
from service.errors import ServiceError

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

CSV = "text/csv"
PARQUET = "application/vnd.apache.parquet"
JSON = "application/json"
MEDIA_TYPES = (CSV, PARQUET, JSON)

BLOCK_BYTES = 8 << 20
PARQUET_ROWS = 65_536
MAX_CELLS = 400_000_000  # what a Parquet file of a few kilobytes may unfold to
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


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
        ObservationError: not such a file, or names that are empty or stand twice.

    """
    if media == CSV:
        return _header(path)
    if media == PARQUET:
        with _parquet(path) as file:
            found = list(file.schema_arrow.names)
        _unique(found)
        return found
    return list(_json(path))


def tables(path: Path, media: str) -> Iterator[pa.Table]:
    """Read a file piece by piece; cells that are empty are null.

    Raises:
        ObservationError: no rows, a ragged row, a cell that is not a finite number.

    """
    pieces = {CSV: _csv_tables, PARQUET: _parquet_tables, JSON: _json_tables}[media](path)
    first = 1
    for table in pieces:
        _finite(table, first)
        first += table.num_rows
        if table.num_rows:
            yield table
    if first == 1:
        raise ObservationError("The upload has no rows.")


def _csv_tables(path: Path) -> Iterator[pa.Table]:
    import pyarrow as pa  # 0.4 s: not at the start of the API process
    from pyarrow import csv as arrow

    columns = _header(path)
    try:
        reader = arrow.open_csv(
            path,
            read_options=arrow.ReadOptions(
                use_threads=False, block_size=BLOCK_BYTES, column_names=columns, skip_rows=1
            ),
            parse_options=arrow.ParseOptions(ignore_empty_lines=False),
            convert_options=arrow.ConvertOptions(column_types=dict.fromkeys(columns, pa.float64()), null_values=[""]),
        )
        for batch in reader:
            yield pa.Table.from_batches([batch])
    except pa.ArrowInvalid as error:
        # Arrow is fast and says too little; the slow reader looks for the place.
        _find_fault(path, columns)
        raise ObservationError(f"The CSV cannot be read: {error}.") from error


def _header(path: Path) -> list[str]:
    with path.open("rb") as file:
        first = file.readline(1 << 20)
    try:
        text = first.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise ObservationError("The CSV is not UTF-8 text: export it as UTF-8.") from error
    if ";" in text or "\t" in text:
        raise ObservationError(
            "The CSV separates its columns by ';' or tabs: export it with commas and decimal points, or let "
            "`kilter upload --device` or `--map` convert it."
        )
    found = next(csv.reader([text]), [])
    if not any(found):
        raise ObservationError("The upload is empty: its first line must name the columns.")
    _unique(found)
    return found


def _unique(names: Sequence[str]) -> None:
    for name in names:
        if not name.strip() or name != name.strip():
            raise ObservationError(f"Column {name!r} is empty or has spaces around it: name it without.", column=name)
        if names.count(name) > 1:
            raise ObservationError(f"Column {name!r} stands twice: keep one of them.", column=name)


def _find_fault(path: Path, names: Sequence[str]) -> None:
    number = 0
    with path.open("r", encoding="utf-8-sig", errors="replace", newline="") as file:
        rows = csv.reader(file)
        next(rows)
        for number, cells in enumerate(rows, 1):
            if len(cells) != len(names):
                raise _at(
                    number,
                    None,
                    f"has {len(cells)} cells where the header has {len(names)}: give every row all columns, "
                    "and decimal points, not commas",
                )
            for name, cell in zip(names, cells, strict=True):
                if cell and not _NUMBER.fullmatch(cell):
                    raise _at(number, name, f"is {cell[:40]!r}, which is not a number: write it like -12.5")
    if number == 0:
        raise ObservationError("The upload has no rows.")


def _parquet(path: Path) -> ParquetFile:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        return parquet.ParquetFile(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise ObservationError(f"The upload is not a Parquet file that can be read: {error}.") from error


def _parquet_tables(path: Path) -> Iterator[pa.Table]:
    import pyarrow as pa

    with _parquet(path) as file:
        columns = file.schema_arrow.names
        _numeric(file.schema_arrow)
        if file.metadata.num_rows * len(columns) > MAX_CELLS:
            raise ObservationError(f"The upload has more than {MAX_CELLS} cells: split it.")
        schema = pa.schema([(name, pa.float64()) for name in columns])
        try:
            for batch in file.iter_batches(batch_size=PARQUET_ROWS, use_threads=False):
                yield pa.Table.from_batches([batch]).cast(schema)
        except (pa.ArrowInvalid, OSError) as error:
            raise ObservationError(f"The upload is not a Parquet file that can be read: {error}.") from error


def _numeric(schema: pa.Schema) -> None:
    import pyarrow as pa

    for field in schema:
        if not (pa.types.is_integer(field.type) or pa.types.is_floating(field.type)):
            raise ObservationError(f"Column {field.name!r} is {field.type}, not numbers.", column=field.name)


def _json(path: Path) -> dict[str, list[Any]]:
    try:
        document = json.loads(path.read_bytes(), object_pairs_hook=_once, parse_constant=_no_constant)
    except ValueError as error:
        raise ObservationError(f"The upload is not JSON: {error}.") from error
    if not isinstance(document, dict) or not all(isinstance(column, list) for column in document.values()):
        raise ObservationError('The JSON must be columns: {"q1_deg": [0, 10], "x_mm": [512.1, 498.3]}.')
    return document


def _json_tables(path: Path) -> Iterator[pa.Table]:
    import pyarrow as pa

    document = _json(path)
    longest = max((len(column) for column in document.values()), default=0)
    for name, column in document.items():
        if len(column) != longest:
            raise _at(len(column) + 1, name, "is missing: give every column as many values")
        _cells(name, column)
    yield pa.table({name: pa.array(column, pa.float64()) for name, column in document.items()})


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _unique([name for name, _ in pairs])
    return dict(pairs)


def _no_constant(name: str) -> float:
    raise ObservationError(f"The JSON holds {name}: leave the row out, or give null for a marker that was not seen.")


def _cells(name: str, column: list[Any]) -> None:
    for number, cell in enumerate(column, 1):
        if cell is not None and (isinstance(cell, bool) or not isinstance(cell, int | float)):
            raise _at(number, name, f"is {str(cell)[:40]!r}, which is not a number")


def _finite(table: pa.Table, first: int) -> None:
    import pyarrow.compute as pc

    for name, column in zip(table.column_names, table.columns, strict=True):
        finite = pc.is_finite(column)
        if not pc.all(finite, skip_nulls=True, min_count=0).as_py():
            row = pc.index(finite, False).as_py()
            raise _at(first + row, name, f"is {column[row].as_py()}: leave the row out, or measure it again")


def _at(row: int, column: str | None, what: str) -> ObservationError:
    place = f"Row {row}" if column is None else f"Row {row}, column {column!r}"
    return ObservationError(f"{place} {what}.", row=row, column=column)
