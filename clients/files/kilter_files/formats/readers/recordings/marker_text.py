"""Text exports of markers or tools, one frame in a line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.reader import NO_HINTS, Document, Head, Hints, RecordingReader
from kilter_files.formats.recordings.marker_header import is_recording
from kilter_files.formats.recordings.marker_text import read_marker_text
from kilter_files.formats.recordings.polaris_long import long_columns
from kilter_files.tables.recording import in_stated_unit

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording


class MarkerText(RecordingReader):
    """Frames of markers, and not one point in a row that somebody chose to measure."""

    name = "text"
    title = "text export of markers or tools, one frame in a line"
    endings = (".csv", ".tsv", ".txt")

    def recognises(self, head: Head) -> bool:
        """A long table of tools, or coordinates with a counter, a rate or a clock."""
        layout = head.layout
        return layout is not None and (long_columns(layout) is not None or is_recording(layout, head.hints.rate_hz))

    def describe(self, head: Head) -> Document:
        """Frames, and gaps and noise of each marker, and how the text is laid out."""
        assert head.layout is not None  # it was recognised
        return super().describe(head) | {"layout": head.layout.to_document()}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames."""
        return in_stated_unit(read_marker_text(path, hints.rate_hz, hints.allow_cut), hints.unit)


READER = MarkerText()
