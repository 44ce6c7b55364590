"""Columns of numbers of a long text file, in blocks: Arrow's fast reader, and a slow one to say where it stopped."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.later import csv, need, np, pa
from kilter_files.ground.text_layout import TextLayout
from kilter_files.ground.time_stamps import parse_stamp

MISSING = ("", "nan", "NaN", "NAN", "NA", "n/a", "N/A", "null", "NULL", "-", "--", "MISSING", "Missing", "missing")
BLANKS = tuple(" " * i for i in range(1, 17))
BLOCK_BYTES = 4 << 20
STAMPED = "Recordings need seconds: export them so, or take the column out and give the rate (--rate)."
SLOW_ROWS = 20_000


def blocks(path: Path, layout: TextLayout, columns: Sequence[int], rows: int) -> Iterator[Floats]:
    """Read ``columns`` (n, columns) of the first ``rows`` rows of numbers, NaN where a cell is empty.

    Raises:
        FileError: a row with more or fewer cells, or a cell that is not a number; line and column are named.

    """
    if layout.delimiter == " ":
        yield from _slow(path, layout, columns, rows)
        return
    left = rows
    need(f"{path}: long text files need", "pyarrow")
    names = [str(i) for i in range(_raw_width(path, layout))]
    wanted = [names[i] for i in columns]
    last = layout.first_line - 1 + rows  # Arrow counts from the file's first line
    try:
        reader = csv.open_csv(
            path,
            read_options=csv.ReadOptions(
                use_threads=False,
                block_size=BLOCK_BYTES,
                column_names=names,
                skip_rows=layout.first_line - 1,
                encoding="utf-8" if layout.encoding == "utf-8-sig" else layout.encoding,
            ),
            parse_options=csv.ParseOptions(
                delimiter=layout.delimiter,
                invalid_row_handler=lambda row: "skip" if row.number is not None and row.number > last else "error",
            ),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(wanted, pa.float64()),
                include_columns=wanted,
                null_values=[*MISSING, *BLANKS],
                decimal_point=layout.decimal,
            ),
        )
        for batch in reader:
            yield np.stack([column.to_numpy(zero_copy_only=False) for column in batch.columns], axis=1)[:left]
            left -= batch.num_rows
    except (pa.ArrowException, UnicodeDecodeError, OSError) as error:
        # Arrow is fast and says too little; the slow reader looks for the place
        for _ in _slow(path, layout, columns, rows):
            pass
        raise fault(path, f"cannot be read ({str(error)[:200]})", "Export it again.") from error


def numbered_lines(path: Path, layout: TextLayout) -> Iterator[tuple[int, str]]:
    """Return the lines of numbers with their numbers in the file; empty ones are skipped."""
    with path.open(encoding=layout.encoding, errors="replace", newline=None) as stream:
        for number, line in enumerate(itertools.islice(stream, layout.first_line - 1, None), layout.first_line):
            if not line.isspace():
                yield number, line


def line_number_of_row(path: Path, layout: TextLayout, row: int) -> int:
    """Return the line of a row of numbers, counted from 0."""
    return next(
        (line for line, _ in itertools.islice(numbered_lines(path, layout), row, None)), layout.first_line + row
    )


def count_rows(path: Path, layout: TextLayout) -> tuple[int, str | None]:
    """Count the rows of numbers, without the last if it breaks off; and a remark where it did.

    A recorder that is stopped leaves half a line behind. A short line anywhere else is damage, which ``blocks`` refuses.
    """
    rows, number, last = 0, 0, ""
    for line in numbered_lines(path, layout):
        rows, (number, last) = rows + 1, line
    remark = cut_remark(number, len(layout.split(last)), layout.width) if rows > 1 else None
    return rows - (remark is not None), remark


def cut_remark(line: int, cells: int, width: int) -> str | None:
    """Say that the last line is left out, None where it is whole."""
    if cells >= width:
        return None
    return f"line {line}, the last, is cut off ({cells} of {width} cells) and left out"


def _raw_width(path: Path, layout: TextLayout) -> int:
    """Cells of a row as Arrow counts them: with the empty one after a last delimiter."""
    _, line = next(numbered_lines(path, layout))
    idle = line.rstrip("\r\n ").endswith(layout.delimiter) and len(layout.split(line)) == layout.width
    bare = line.rstrip("\r\n").count(layout.delimiter) + 1
    return max(layout.width + 1 if idle and bare > layout.width else layout.width, 1)


def _slow(path: Path, layout: TextLayout, columns: Sequence[int], count: int) -> Iterator[Floats]:
    rows: list[list[float]] = []
    for number, line in itertools.islice(numbered_lines(path, layout), count):
        cells = layout.split(line)
        if len(cells) != layout.width:
            raise _ragged_row_fault(path, layout, number, cells)
        rows.append([_number(path, layout, number, cells, i) for i in columns])
        if len(rows) == SLOW_ROWS:
            yield np.array(rows)
            rows = []
    if rows:
        yield np.array(rows)


def _ragged_row_fault(path: Path, layout: TextLayout, line: int, cells: list[str]) -> FileError:
    if _is_header_again(layout, cells):
        return _second_header_fault(path, line)
    what = f"{len(cells)} cells where the first row has {layout.width}"
    return fault(path, what, "Correct the row; if another table begins here, split the file.", line=line)


def _number(path: Path, layout: TextLayout, line: int, cells: list[str], i: int) -> float:
    text = cells[i]
    value = float("nan") if text in MISSING else parse_number(text, layout.decimal)
    if value is None and _is_header_again(layout, cells):
        raise _second_header_fault(path, line)
    if value is None:
        name = layout.names[i]
        what = f"{text[:40]!r} is not a number with decimal {layout.decimal!r}"
        if parse_stamp(text) is not None:
            raise fault(path, f"{text[:40]!r} is a time stamp", STAMPED, line=line, column=name)
        raise fault(path, what, "Correct the cell; if all columns moved here, export again.", line=line, column=name)
    return value


def _is_header_again(layout: TextLayout, cells: list[str]) -> bool:
    said = [cell for cell in cells if cell]
    return bool(said) and sum(parse_number(cell, layout.decimal) is None for cell in said) > len(said) / 2


def _second_header_fault(path: Path, line: int) -> FileError:
    return fault(path, "a second header is here: two recordings are concatenated", "Split the file.", line=line)
