"""MATLAB files."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.mat import read_mat
from kilter_files.formats.unknown.understood import cached_understanding, describe_table
from kilter_files.ground.later import np
from kilter_files.tables.source import Source

COMES_IN = "comes in with a column map (kilter upload --map); --draft writes a first one"


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
        """Variables and their shapes, and what a draft of a map takes their columns for."""
        variables = read_mat(head.path).variables
        shapes = [{"name": name, "shape": list(np.shape(value))} for name, value in sorted(variables.items())]
        table = describe_table(head) if cached_understanding(head) is not None else {"notes": [COMES_IN]}
        return {**table, "kind": self.name, "variables": shapes}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the variables."""
        return read_mat(path, hints.layout.missing_numbers)


READER = Mat()
