"""Lists of records as JSON, which come in through a column map."""

from __future__ import annotations

import json
from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.text import find_records, read_json_records
from kilter_files.formats.unknown.understood import describe_table
from kilter_files.tables.source import Source

MOST_BYTES = 64 << 20


class JsonRecords(Reader[Source]):
    """A list of objects, one for each pose, in the document or somewhere in it."""

    name = "json"
    title = "a JSON list of poses"
    use = MAP
    endings = (".json",)

    def recognises(self, head: Head) -> bool:
        """A document that is called JSON and holds a list of objects: contract columns are lists of numbers."""
        if head.ending not in self.endings or head.path.is_dir() or head.path.stat().st_size > MOST_BYTES:
            return False
        try:
            return bool(find_records(json.loads(head.path.read_bytes())))
        except (ValueError, RecursionError):
            return False

    def describe(self, head: Head) -> Document:
        """Columns with ranges, and what a draft of a map takes them for."""
        return describe_table(head)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the records."""
        return read_json_records(path, hints.layout)


READER = JsonRecords()
