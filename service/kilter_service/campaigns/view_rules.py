"""What a row of pixels must be: corners within the picture of a camera that the campaign describes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError
from kilter_core.observations import Rig
from kilter_core.types import Bools, Floats
from kilter_service.contract.columns import NAMED, PIXELS
from kilter_service.ground.tables.assemble import rig_from_conditions
from kilter_service.ground.tables.columns import Column, has

EDGE = 0.5  # px: the picture ends half a pixel beyond the centres of its outermost pixels


class ViewRules:
    """The rules for the corners of one upload; with a ``rig`` also for what its cameras and boards can show."""

    def __init__(self, columns: Sequence[Column], rig: Rig | None) -> None:
        self._rig = rig
        self._names = {c.quantity: c.name for c in columns if c.quantity in NAMED}
        self._corners = {(c.quantity, c.number or 0): c.name for c in columns if c.quantity in PIXELS}
        self._numbers = sorted({number for _, number in self._corners})
        self._alone = not any(has(columns, quantity) for quantity in ("x", "marker_x", "link", "tilt_x", "tilt_y"))

    def check(self, cells: Mapping[str, Floats], before: int) -> None:
        """Check the next rows, of which the first comes after ``before`` others.

        Raises:
            ObservationError: an invalid cell; row and column are named.

        """
        seen = np.zeros((len(next(iter(cells.values()))), len(self._numbers)), dtype=bool)
        for place, k in enumerate(self._numbers):
            name = self._corners["pixel_u", k]
            u, v = (np.isnan(cells[self._corners[f"pixel_{axis}", k]]) for axis in "uv")
            _refuse(u != v, name, before, "and its neighbour must both be given, or both be empty")
            seen[:, place] = ~u
            for axis in "uv":
                sigma = self._corners.get((f"pixel_s{axis}", k))
                if sigma is not None:
                    _refuse(cells[sigma] <= 0, sigma, before, "is not a standard deviation: it must be above 0")
        if self._alone:
            name = self._corners["pixel_u", self._numbers[0]]
            _refuse(np.asarray(~seen.any(axis=1)), name, before, "and all other corners are empty: leave the row out")
        if self._rig is not None:
            self._check_rig(self._rig, cells, before, seen)

    def _check_rig(self, rig: Rig, cells: Mapping[str, Floats], before: int, seen: Bools) -> None:
        some: Bools = np.asarray(seen.any(axis=1))
        number = {}
        for what, parts in (("camera", rig.cameras), ("board", rig.boards)):
            column = self._names.get(what)
            own = np.ones(len(some)) if column is None else cells[column]
            if column is not None:
                wrong = some & ~((own >= 1) & (own <= len(parts)))
                named = ", ".join(p.name for p in parts)
                said = f"names none of {named}: correct the cell, or describe that {what} in the campaign"
                _refuse(wrong, column, before, said, f"{what}_unknown")
            number[what] = np.where(some, np.nan_to_num(own, nan=1.0), 1.0).astype(np.int64) - 1
        sizes = np.array([c.size for c in rig.cameras])[number["camera"]]
        corners = np.array([len(b.corners) for b in rig.boards])[number["board"]]
        for place, k in enumerate(self._numbers):
            beyond = seen[:, place] & (k >= corners)
            _refuse(
                beyond,
                self._corners["pixel_u", k],
                before,
                "is of a corner that the board does not have: describe the board that was seen, with all its corners",
                "corner_unknown",
            )
            for axis, letter in enumerate("uv"):
                name = self._corners[f"pixel_{letter}", k]
                outside = (cells[name] < -EDGE) | (cells[name] > sizes[:, axis] - EDGE)
                _refuse(
                    outside,
                    name,
                    before,
                    "is outside the picture of its camera: describe the camera that saw it, with the full size of its pictures",
                    "outside_picture",
                )


def views_rules(columns: Sequence[Column], conditions: Mapping[str, Any] | None) -> ViewRules | None:
    """The rules of an upload; None without pixels.

    Raises:
        ObservationError: ``cameras_missing``, or a column that must say which of several is meant.

    """
    if not has(columns, "pixel_u"):
        return None
    rig = None if conditions is None else rig_from_conditions(conditions)
    if conditions is not None and rig is None:
        raise ObservationError(
            "The upload has pixels, and the campaign describes no cameras and boards: make a campaign whose conditions have "
            "cameras and boards, as `kilter measure see` writes them (`kilter upload --cameras`).",
            code="cameras_missing",
        )
    if rig is not None:
        for what, parts in (("camera", rig.cameras), ("board", rig.boards)):
            if len(parts) > 1 and not has(columns, what):
                raise ObservationError(
                    f"Column {what!r} is missing: the campaign has {len(parts)} {what}s, and each row must name one.",
                    code="cameras_missing",
                    column=what,
                )
    return ViewRules(columns, rig)


def _refuse(wrong: NDArray[np.bool_], name: str, before: int, what: str, code: str | None = None) -> None:
    if wrong.any():
        row = before + int(np.argmax(wrong)) + 1
        raise ObservationError(f"Row {row}, column {name!r} {what}.", code=code, row=row, column=name)
