"""Fraunhofer IPA's campaigns with a laser tracker."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.points.ipa_lasertracker import NEEDED, read_ipa_lasertracker
from kilter_files.formats.reader import DEVICE, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.unknown.described import describe_table
from kilter_files.tables.table import Table


class IpaLasertracker(Reader[Table]):
    """One series."""

    name = "ipa-lasertracker"
    title = "A campaign of Fraunhofer IPA's laser tracker data set"
    use = DEVICE

    def recognises(self, head: Head) -> bool:
        """All columns of a series."""
        return not head.hints.say_points and head.layout is not None and set(NEEDED) <= set(head.layout.names)

    def describe(self, head: Head) -> Document:
        """Columns as they stand in the file, and how it is sent."""
        found = describe_table(head)
        return found | {
            "kind": self.name, "device": self.name, "ready": True,
            "notes": [f"ready for kilter upload --device {self.name}", *found["notes"]],
        }  # fmt: skip

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Read the series."""
        return read_ipa_lasertracker(path)


READER = IpaLasertracker()
