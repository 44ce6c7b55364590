"""Logs of inclinometers."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.instrument_logs import describe_inclinometer, tilt_column_indices
from kilter_files.formats.marker_header import understand
from kilter_files.formats.reader import DEVICE, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.ground.errors import FileError
from kilter_files.tables.table import Table


class InclinometerLog(Reader[Table]):
    """Time and inclinations, which make no campaign."""

    name = "inclinometer"
    title = "The log of an inclinometer: no campaign, see `kilter measure tilt-join`"
    use = DEVICE

    def recognises(self, head: Head) -> bool:
        """Columns that are inclinations, without coordinates."""
        return head.layout is not None and bool(tilt_column_indices(head.layout)) and not understand(head.layout).xyz

    def describe(self, head: Head) -> Document:
        """Ranges of the inclinations."""
        return describe_inclinometer(head)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Refuse it: an inclinometer measures joints.

        Raises:
            FileError: always, with what to do instead.

        """
        raise FileError(
            f"{path}: an inclinometer measures joints, not tool positions, so it makes no campaign. See what it holds with "
            "`kilter measure inspect`, and send readings with `kilter measure joint-parameters ROBOT --readings FILE`.",
            file=str(path),
        )


READER = InclinometerLog()
