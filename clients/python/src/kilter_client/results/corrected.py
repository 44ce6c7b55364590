"""Corrected trajectories and programs, and what an upload would store."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import UsageError
from kilter_client.results.record import Record
from kilter_client.results.rows import Rows, html_table, saved_together, write_file
from kilter_files.ground.later import need
from kilter_files.tables import CSV_TYPE, JSON_TYPE, PARQUET_TYPE

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd


class Corrected(bytes):
    """A corrected trajectory, as bytes of a file.

    ``left_out`` are effects of the version that it does not cover, ``notes`` what else the server says of it,
    ``u95`` what its intervals are of: poses, or a path whose neighbouring rows share their error.
    """

    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    u95: str = ""
    media_type: str = CSV_TYPE

    @property
    def rows(self) -> Rows:
        """The rows: joints in deg (prismatic in mm), the predicted error removed as ``dx_mm`` to ``dz_mm``, what is left of
        it as ``left_mm``, half the 95 % interval of where the tool is as ``u95_x_mm`` to ``u95_z_mm``, ``flags``, ``status``.

        Raises:
            MissingPackageError: it is Parquet and pyarrow is not installed.
            UsageError: it is in the form of ROS 2, which has no such rows.

        """
        if self.media_type == CSV_TYPE:
            return Rows(bytes(self))
        if self.media_type == JSON_TYPE:
            return Rows(bytes(self), json.loads(self))
        if self.media_type == PARQUET_TYPE:
            return Rows(bytes(self), _of_parquet(bytes(self)))
        raise UsageError(f"A trajectory of type {self.media_type} has no rows: leave out form=, or use save().")

    def to_dict(self) -> dict[str, list[Any]]:
        """Return the columns of the rows by name."""
        return self.rows.to_dict()

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """Return the rows as a structured array."""
        return self.rows.to_numpy()

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a pandas DataFrame."""
        return self.rows.to_pandas()

    @property
    def status(self) -> dict[str, int]:
        """How many rows have which status: ``OK`` where what is left is within what is stated, ``DAMPED`` and ``LIMITED``
        where it is not, ``UNSURE`` where the version is less sure than it says; all others are refusals, whose cells are empty.
        """
        return dict(Counter(self.rows.to_dict().get("status", ())))

    def describe_changes(self) -> str:
        """Say how far the tool is moved at most and what is left of its error, as the end of a sentence; CSV and JSON alone."""
        if self.media_type not in (CSV_TYPE, JSON_TYPE):
            return ""
        rows = self.rows
        # Of rows that are OK no more is left than the version states of itself.
        left = {"DAMPED", "LIMITED"} & set(rows.to_dict().get("status", ()))
        kept = f", most left {_largest(rows, 'left_mm')}" if left else ""
        return f", largest change {_largest(rows, 'dx_mm', 'dy_mm', 'dz_mm')}{kept}"

    def save(self, path: Path | str) -> Path:
        """Write the file, byte for byte as it came.

        Raises:
            FileError: the file cannot be written.

        """
        return write_file(bytes(self), path)

    def __repr__(self) -> str:
        left = f"; not corrected is what {', '.join(self.left_out)} does" if self.left_out else ""
        if self.media_type not in (CSV_TYPE, JSON_TYPE):
            return f"corrected trajectory: {len(self)} bytes of {self.media_type}{left}"
        told = ", ".join(f"{count} {name}" for name, count in self.status.items())
        return f"corrected trajectory: {len(self.rows)} rows ({told}){self.describe_changes()}{left}"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        if self.media_type not in (CSV_TYPE, JSON_TYPE):
            return html_table((), (), repr(self))
        return self.rows._repr_html_()


def _largest(rows: Rows, *names: str) -> str:
    """The largest length of these columns together."""
    columns = rows.to_dict()
    steps = zip(*(columns.get(name, ()) for name in names), strict=True)
    sizes = [sum(float(d) ** 2 for d in step) ** 0.5 for step in steps if None not in step]
    return f"{max(sizes, default=0.0):.3g} mm"


def _of_parquet(content: bytes) -> dict[str, list[Any]]:
    parquet = need("Rows of Parquet need", "pyarrow", "pyarrow.parquet")
    found: dict[str, list[Any]] = parquet.read_table(io.BytesIO(content)).to_pydict()
    return found


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
