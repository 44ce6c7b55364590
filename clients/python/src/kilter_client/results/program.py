"""A robot program with its targets corrected."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kilter_client.errors import UsageError
from kilter_client.results.record import Record
from kilter_client.results.rows import saved_together, write_file


class FilteredProgram(Record):
    """A program with its targets corrected: ``text``, and what to review before an arm runs it.

    A KRL program of two files has both in ``texts``, by name; ``text`` is the one that was given. ``diff`` has the changed
    lines, ``targets`` their number, ``largest_change_deg`` and ``largest_change_line`` the largest change of a joint,
    ``not_ok`` the targets that are damped or limited, ``left`` the lines that are not rewritten, and ``notes`` what else
    is to be known.
    """

    dialect: str
    """Language of the program."""
    texts: Mapping[str, str]
    """Its files as corrected, by name, the one that was given first."""
    targets: int
    """Number of targets, joints and poses."""
    largest_change_deg: float
    """Largest change of a joint, deg."""
    largest_change_line: int
    """Line of the target that it is in."""
    largest_change_file: str
    """Name of the file that has this line."""
    not_ok: tuple[Mapping[str, Any], ...]
    """Targets that are corrected and whose status is not OK: ``file``, ``line``, ``name``, ``status``, ``at_limits``.

    ``at_limits`` names the joints that their limits hold, with angle and limit; None where none does.
    """
    left: tuple[Mapping[str, Any], ...]
    """Lines that are not rewritten though an arm may move by them: ``file``, ``line``, ``what``."""
    notes: tuple[str, ...]
    """What else is to be known: of the program, and what the server says of the correction."""
    diff: str
    """The changed lines, as a unified diff."""

    @property
    def text(self) -> str:
        """The corrected file that was given."""
        return next(iter(self.texts.values()))

    def paths(self, path: Path | str) -> list[Path]:
        """Return where ``save`` writes: ``path``, and the second file of a program beside it, with its own ending.

        Raises:
            UsageError: there are two files, and ``path`` has not the ending of the one that was given.

        """
        given, *others = map(Path, self.texts)
        first = Path(path)
        if others and first.suffix != given.suffix:
            raise UsageError(f"{first}: {others[0]} is written beside it, so name a file that ends in {given.suffix}.")
        return [first, *(first.with_suffix(other.suffix) for other in others)]

    def save(self, path: Path | str) -> Path:
        """Write the corrected program; the second file of a KRL program is written beside it: both, or neither.

        Raises:
            FileError: a file cannot be written; then those that were there are as they were.

        """
        contents = [text.encode("latin-1") for text in self.texts.values()]
        places = self.paths(path)
        if len(places) == 1:
            return write_file(contents[0], path)
        saved_together(dict(zip(places, contents, strict=True)))
        return Path(path)

    def _line_label(self, line: object, file: object) -> str:
        return f"{file}:{line}" if len(self.texts) > 1 else f"line {line}"

    def __repr__(self) -> str:
        worst = self._line_label(self.largest_change_line, self.largest_change_file)
        change = f"largest change {self.largest_change_deg:.3g} deg ({worst})"
        held = f", {len(self.not_ok)} not OK" if self.not_ok else ""
        places = ", ".join(self._line_label(one["line"], one["file"]) for one in self.left)
        left = f"; left as they are: {places}" if self.left else ""
        return f"{self.dialect}: targets: {self.targets}, {change}{held}{left}"
