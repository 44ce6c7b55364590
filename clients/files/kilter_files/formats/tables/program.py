"""Joint targets of a robot program as columns q1, q2, ... in degrees, in the order the program moves to them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kilter_files.formats.programs.targets import read_targets
from kilter_files.tables.source import Layout
from kilter_files.tables.text_source import TextSource


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
