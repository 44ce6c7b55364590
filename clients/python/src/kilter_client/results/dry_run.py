"""What an upload would store, and what would be refused of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.results.record import Record


class DryRun(Record):
    """What a file or columns hold, before anything is stored."""

    columns: tuple[str, ...]
    """Columns that were converted; empty where contract columns are sent as they are."""
    rows: int | None
    """Number of rows."""
    ranges: tuple[Mapping[str, Any], ...]
    """Lowest and highest value of each column, in mm and deg, and its empty cells."""
    poses: Mapping[str, Any] | None
    """How many poses, and how often each was visited."""
    loads: Mapping[str, Any] | None
    """Loads of the rows and of the campaign."""
    directions: Mapping[str, Any] | None
    """Directions of approach of each joint, counted."""
    left_out: tuple[str, ...]
    """Rows that rules of the column map leave out."""
    refused: tuple[str, ...]
    """What would be refused."""
    odd: tuple[str, ...]
    """What the server finds odd, though it would store it."""
    not_checked: str
    """What could not be checked, and why."""
    notes: tuple[str, ...]
    """What was understood of the file."""
    warnings: tuple[str, ...]
    """What is to be looked at in the file."""

    @property
    def ok(self) -> bool:
        """Whether nothing would be refused, as far as it was checked."""
        return not self.refused
