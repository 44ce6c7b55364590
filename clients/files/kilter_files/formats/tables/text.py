"""Delimited text (CSV and its relatives) as columns by name."""

from __future__ import annotations

import csv
from pathlib import Path

from kilter_files.ground.errors import FileError
from kilter_files.tables.source import Layout
from kilter_files.tables.text_source import TextSource, header_names


def read_text(path: Path, layout: Layout) -> TextSource:
    """Read a delimited text file.

    Raises:
        FileError: unreadable, empty, a repeated column name, or a row with more or fewer cells than the header.

    """
    records = _records(path, layout)
    if not records:
        raise FileError(f"{path}: no rows. Export the measurement again, or lower 'skip_rows'.", file=str(path))
    if layout.header:
        (_, head), records = records[0], records[1:]
        names = header_names(path, head)
        records = records[1:] if layout.units_row else records
    else:
        records = _join_pose_rows(path, records, layout.rows_per_pose)
        names = [str(i) for i in range(len(records[0][1]))]
    _refuse_ragged(path, names, records, layout)
    return TextSource(path, layout, names, [row for _, row in records], [line for line, _ in records])


def _records(path: Path, layout: Layout) -> list[tuple[int, list[str]]]:
    try:
        with path.open(encoding=layout.encoding, newline="") as stream:
            for _ in range(layout.skip_rows):
                stream.readline()
            reader = csv.reader(stream, delimiter=layout.delimiter, skipinitialspace=layout.delimiter == " ")
            found, before = [], 0
            for row in reader:  # a row with quoted line breaks has the number of its first line
                if any(cell.strip() for cell in row) and not (layout.comment and row[0].startswith(layout.comment)):
                    found.append((layout.skip_rows + before + 1, row))
                before = reader.line_num
            return found
    except (OSError, csv.Error) as error:
        raise FileError(f"{path}: cannot be read: {error}.", file=str(path)) from error
    except (UnicodeDecodeError, LookupError) as error:
        raise FileError(
            f"{path}: is not {layout.encoding} text ({error}). State its 'encoding', for example \"latin-1\".",
            file=str(path),
        ) from error


def _join_pose_rows(path: Path, records: list[tuple[int, list[str]]], count: int) -> list[tuple[int, list[str]]]:
    """Join rows that make one pose together, as those of a matrix; each has the line of its first."""
    if len(records) % count:
        raise FileError(
            f"{path}: {len(records)} rows are not whole poses of {count}. Correct the file, or 'rows_per_pose'.",
            file=str(path),
        )
    blocks = (records[k : k + count] for k in range(0, len(records), count))
    return [(block[0][0], [cell for _, cells in block for cell in cells]) for block in blocks]


def _refuse_ragged(path: Path, names: list[str], records: list[tuple[int, list[str]]], layout: Layout) -> None:
    for line, row in records:
        if len(row) != len(names):
            raise FileError(
                f"{path}, line {line}: {len(row)} cells where the header has {len(names)}. "
                f"Correct the row, or set 'delimiter' (now {layout.delimiter!r}).",
                file=str(path),
                line=line,
            )
