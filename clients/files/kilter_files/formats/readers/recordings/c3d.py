"""C3D recordings of markers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.reader import NO_HINTS, Head, Hints, RecordingReader
from kilter_files.formats.recordings.c3d import read_c3d
from kilter_files.formats.recordings.c3d_parameters import is_c3d
from kilter_files.tables.recording import in_stated_unit

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording


class C3d(RecordingReader):
    """Markers of Optotrak, Qualisys and Vicon."""

    name = "c3d"
    title = "C3D recording of markers (Vicon, Qualisys, Motive, Optotrak)"
    is_a = "a C3D recording"
    endings = (".c3d",)

    def recognises(self, head: Head) -> bool:
        """The second byte, and the number of the block before it; or the ending, so that damage is named."""
        return is_c3d(head.start) or head.ending in self.endings

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames."""
        return in_stated_unit(read_c3d(path, hints.allow_cut), hints.unit)


READER = C3d()
