"""How an unknown table is read: its columns with ranges, what a draft takes them for, and how to send it."""

from __future__ import annotations

from shlex import quote

from kilter_files.formats.reader import Document, Head
from kilter_files.formats.unknown.understood import cached_understanding, understand


def describe_table(head: Head) -> Document:
    """Describe a table that no reader of a device knows.

    Raises:
        FileError: no table of numbers.

    """
    found = cached_understanding(head) or understand(head.path, head.hints.robot)
    shape, columns = found.shape, found.columns
    out = []
    for name in columns.names:
        values = columns.numbers(name)
        low, high = (min(values), max(values)) if values else (None, None)
        empty = len(shape.source.lines) - len(values) if values is not None and shape.source.lines else None
        out.append({"name": name, "unit": columns.unit(name), "low": low, "high": high, "empty": empty})
    sheet = [] if shape.layout.sheet is None else [f"sheet {shape.layout.sheet!r}"]
    read = [f"check {text}" for text in found.guess_remarks] + [f"not told: {text}" for text in found.open]
    read += [f"not used: {', '.join(found.unused_columns)}"] if found.unused_columns else []
    note = (
        f"comes in with a column map; a first one: kilter measure inspect {quote(str(head.path))} --draft columns.toml"
    )
    return {"kind": "table", "rows": len(shape.source.lines), "columns": out, "notes": [*sheet, *read, note]}
