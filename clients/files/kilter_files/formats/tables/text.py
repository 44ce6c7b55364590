"""Delimited text (CSV and its relatives) as columns by name.

Lists of records, as JSON or YAML: a pose in each, with its joints and its point as lists or by name.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, fault, read_head
from kilter_files.ground.later import need
from kilter_files.tables.source import Layout, TextSource, header_names


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


MOST_BYTES = 64 << 20
REMEDY = 'Write a list of records, such as [{"joints": [...], "position": [...]}, ...].'


@dataclass
class RecordSource(TextSource):
    """Read records: what each holds as cells, lists in one cell."""

    def row_location(self, line: int) -> str:
        """Say where a record is: its number from 1."""
        return f"record {line}"


def read_json_records(path: Path, layout: Layout) -> RecordSource:
    """Read a list of records from JSON.

    Raises:
        FileError: not JSON, no list of records, or records without a common field.

    """
    try:
        content = json.loads(_read_limited_bytes(path))
    except (ValueError, RecursionError) as error:
        raise fault(path, f"is not JSON ({error})", "Write it again.") from error
    return _source(path, content, layout)


def read_yaml_records(path: Path, layout: Layout) -> RecordSource:
    """Read a list of records from YAML.

    Raises:
        FileError: not YAML, no list of records, or records without a common field.
        MissingPackageError: pyyaml is not installed.

    """
    yaml = need(f"{path}: YAML files need", "pyyaml", "yaml")
    try:
        content = yaml.safe_load(_read_limited_bytes(path))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise fault(path, f"is not YAML ({str(error)[:120]})", "Write it again.") from error
    return _source(path, content, layout)


def find_records(content: Any) -> list[dict[str, Any]]:
    """Return the records of a document: the document itself, or the longest list of records in it; none: empty."""
    if isinstance(content, list):
        if content and all(isinstance(one, dict) for one in content):
            return content
        if content and all(isinstance(one, list) for one in content):
            return [{"row": one} for one in content]
        return []
    if isinstance(content, dict):
        values = list(content.values())
        columns = _columns_of_vectors(content)
        if columns:
            return columns
        if values and all(isinstance(one, dict) for one in values) and len(values) > 1:  # poses by their names
            return [{"name": name, **one} for name, one in content.items()]
        return max((find_records(one) for one in values if isinstance(one, list | dict)), key=len, default=[])
    return []


def _columns_of_vectors(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The records of a document that has a list for each quantity, one of them of vectors; lists of numbers are columns."""
    lists = {name: values for name, values in content.items() if isinstance(values, list) and len(values) > 1}
    vectors = [values for values in lists.values() if all(isinstance(one, list) for one in values)]
    if len(lists) < 2 or not vectors:
        return []
    count = max(map(len, vectors))
    whole = {name: values for name, values in lists.items() if len(values) == count}
    return [{name: values[k] for name, values in whole.items()} for k in range(count)] if len(whole) > 1 else []


def _read_limited_bytes(path: Path) -> bytes:
    content = read_head(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB", "Save it as CSV or Parquet.")
    return content


def _source(path: Path, content: Any, layout: Layout) -> RecordSource:
    records = [dict(_fields(one)) for one in find_records(content)]
    names = [*dict.fromkeys(name for one in records for name in one)]
    if not names:
        raise fault(path, "holds no list of records", REMEDY)
    cells = [[one.get(name, "") for name in names] for one in records]
    return RecordSource(path, layout, names, cells, list(range(1, len(cells) + 1)))


def _fields(record: Mapping[str, Any], stem: str = "") -> Iterator[tuple[str, str]]:
    """The values of a record as text, those of records in it by ``outer.inner``."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{stem}{name}.")
        elif value is not None:
            is_text = isinstance(value, str)
            yield f"{stem}{name}", value if is_text else json.dumps(value, default=str)
