"""Programs of robots, by the joint targets in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kilter_files.formats.joints.joint_log import describe_log, log_of_targets
from kilter_files.formats.programs.marks import detect_dialect, read_targets
from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.tables.source import Layout, Source, TextSource


def read_program(path: Path, layout: Layout) -> TextSource:
    """Read the joint targets of a program; the column ``name`` holds what the program calls them.

    Raises:
        FileError: no joint targets, or damaged ones.

    """
    found = read_targets(path)
    names = ["name", *(f"q{k}" for k in range(1, len(found.joints_deg[0]) + 1))]
    rows = zip(found.names, found.joints_deg, strict=True)
    cells = [[name, *map(repr, joints)] for name, joints in rows]
    return TextSource(path, replace(layout, decimal="."), names, cells, found.lines)


class Program(Reader[Source]):
    """Joint targets as columns q1, q2, ... in degrees."""

    name = "program"
    title = "joint targets of a robot program"
    use = MAP
    endings = (".mod", ".modx", ".sys", ".sysx", ".prg", ".src", ".ls", ".script", ".urscript")

    def recognises(self, head: Head) -> bool:
        """A text with targets of a dialect, whatever its ending."""
        return not head.path.is_dir() and detect_dialect(head.path) is not None

    def describe(self, head: Head) -> Document:
        """Ranges of the joints."""
        return describe_log(log_of_targets(head.path))

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the targets."""
        return read_program(path, hints.layout)


READER = Program()
