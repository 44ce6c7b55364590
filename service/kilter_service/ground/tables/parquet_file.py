"""Parquet uploads: checked first, then decoded in pieces, because a few kilobytes may unpack to gigabytes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_core.errors import ObservationError
from kilter_files.ground.later import pa, parquet
from kilter_service.contract.columns import NAMED
from kilter_service.ground.limits import BATCH_CELLS, MAX_CELLS, MAX_COLUMNS
from kilter_service.ground.tables.columns import check_names
from kilter_service.ground.tables.names import Names
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
                "`kilter match`, `kilter see` or `kilter upload`.",
                column=field.name[:64],
            )
