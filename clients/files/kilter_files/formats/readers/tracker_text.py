"""Points of trackers and measuring machines, exported as text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from kilter_files.formats.points.described import describe_points
from kilter_files.formats.points.tracker_text import read_tracker
from kilter_files.formats.reader import NO_HINTS, PRESET, Document, Head, Hints, Reader
from kilter_files.formats.tracker_header import PRESETS
from kilter_files.tables.table import Table


class TrackerText(Reader[Table]):
    """Points, or poses, in the way of a program."""

    name = "tracker-text"
    title = "points exported as text"
    use = PRESET

    def recognises(self, head: Head) -> bool:
        """Whatever text no other reader knows."""
        return True

    def describe(self, head: Head) -> Document:
        """Ranges of the coordinates, and points that cannot be right."""
        return describe_points(head, self.read(head.path, head.hints))

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Read the points, with the joints of the hints beside them."""
        return read_tracker(path, hints.preset, hints.euler, hints.joints)

    def names_and_titles(self) -> Iterator[tuple[str, str]]:
        """Each preset."""
        for name, preset in PRESETS.items():
            yield name, f"{self.title}: {preset.title}"


READER = TrackerText()
