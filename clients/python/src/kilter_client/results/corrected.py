"""A corrected trajectory."""

from __future__ import annotations

import io
import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import UsageError
from kilter_client.results.rows import Rows, html_table, write_file
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
