"""A robot program with its joint targets corrected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_client.results.record import Record
from kilter_client.results.rows import saved


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FilteredProgram(Record):
    """A program with its joint targets corrected: ``text``, and what to review before an arm runs it.

    ``diff`` has the changed lines, ``targets`` their number, ``largest_change_deg`` and ``largest_change_line`` the largest
    change of a joint, ``not_ok`` the targets that are damped or limited, ``left`` the lines that are not rewritten, and
    ``notes`` what else the server says.
    """

    dialect: str
    """Language of the program."""
    text: str
    """The corrected program."""
    targets: int
    """Number of joint targets."""
    largest_change_deg: float
    """Largest change of a joint, deg."""
    largest_change_line: int
    """Line of the target that it is in."""
    not_ok: tuple[Mapping[str, Any], ...]
    """Targets that are corrected and whose status is not OK: ``line``, ``name``, ``status``."""
    left: tuple[Mapping[str, Any], ...]
    """Lines that are not rewritten though an arm may move by them: ``line``, ``what``."""
    notes: tuple[str, ...]
    """What else the server says of the correction."""
    diff: str
    """The changed lines, as a unified diff."""

    def save(self, path: Path | str) -> Path:
        """Write the corrected program.

        Raises:
            FileError: the file cannot be written.

        """
        return saved(self.text.encode("latin-1"), path)

    def __repr__(self) -> str:
        change = f"largest change {self.largest_change_deg:.3g} deg (line {self.largest_change_line})"
        held = f", {len(self.not_ok)} not OK" if self.not_ok else ""
        left = f"; lines left as they are: {', '.join(str(one['line']) for one in self.left)}" if self.left else ""
        return f"{self.dialect}: targets: {self.targets}, {change}{held}{left}"
