"""NDI's floating-point recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.reader import NO_HINTS, Head, Hints, RecordingReader
from kilter_files.formats.recordings.ndi_n3d import is_n3d, read_n3d
from kilter_files.tables.recording import in_stated_unit

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording


class N3d(RecordingReader):
    """Markers of an Optotrak."""

    name = "n3d"
    title = "NDI's floating-point recording (Optotrak)"
    is_a = "a recording of NDI's"
    endings = (".n3d",)

    def recognises(self, head: Head) -> bool:
        """The numbers of its header; or the ending, so that damage is named."""
        return (b"\0" in head.start and is_n3d(head.start)) or head.ending in self.endings

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames."""
        return in_stated_unit(read_n3d(path, hints.allow_cut), hints.unit)


READER = N3d()
