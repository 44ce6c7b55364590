"""MATLAB files."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.mat import read_mat
from kilter_files.ground.later import np
from kilter_files.tables.source import Source


class Mat(Reader[Source]):
    """Columns of the variables."""

    name = "mat"
    title = "MATLAB, up to version 7"
    use = MAP
    endings = (".mat",)
    is_a = "a MATLAB file"
    instead = "Send it with a column map (kilter upload --map)."

    def recognises(self, head: Head) -> bool:
        """What MATLAB writes first."""
        return head.start.startswith(b"MATLAB 5.0")

    def describe(self, head: Head) -> Document:
        """Variables and their shapes."""
        variables = read_mat(head.path).variables
        shapes = [{"name": name, "shape": list(np.shape(value))} for name, value in sorted(variables.items())]
        return {
            "variables": shapes,
            "notes": ["comes in with a column map (kilter upload --map); --draft writes a first one"],
        }

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the variables."""
        return read_mat(path, hints.layout.missing_numbers)


READER = Mat()
