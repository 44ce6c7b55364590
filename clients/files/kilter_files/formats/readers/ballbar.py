"""Logs of double ball bars."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.instrument_logs import ballbar_table, describe_ballbar, is_ballbar
from kilter_files.formats.reader import DEVICE, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.tables.table import Table


class BallBarLog(Reader[Table]):
    """Angle and radius, or its deviation."""

    name = "ballbar"
    title = "The log of a double ball bar"
    use = DEVICE

    def recognises(self, head: Head) -> bool:
        """Columns that are an angle and a radius."""
        return head.layout is not None and is_ballbar(head.layout)

    def describe(self, head: Head) -> Document:
        """Runs, and their circles."""
        return describe_ballbar(head)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Read lengths of a bar, with the joints that stand beside them."""
        return ballbar_table(path)


READER = BallBarLog()
