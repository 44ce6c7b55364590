"""Lists of records as YAML, which come in through a column map."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.text import read_yaml_records
from kilter_files.formats.unknown.understood import describe_table
from kilter_files.tables.source import Source


class YamlRecords(Reader[Source]):
    """A list of records, one for each pose, in the document or somewhere in it."""

    name = "yaml"
    title = "a YAML list of poses"
    use = MAP
    endings = (".yaml", ".yml")

    def recognises(self, head: Head) -> bool:
        """By its ending: a bag's description is asked for before."""
        return head.ending in self.endings

    def describe(self, head: Head) -> Document:
        """Columns with ranges, and what a draft of a map takes them for."""
        return describe_table(head)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the records."""
        return read_yaml_records(path, hints.layout)


READER = YamlRecords()
