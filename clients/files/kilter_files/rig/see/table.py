"""Views as rows of contract columns, written one after the other."""

from __future__ import annotations

import csv
from typing import TextIO

from kilter_files.ground.arrays import Floats
from kilter_files.rig.see.target import Target
from kilter_files.rig.see.views import View
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.table import cells

PIXEL_DIGITS = SIGMA_DIGITS = 4


class Rows:
    """Writes the head, and a row for every view, to a stream."""

    def __init__(self, stream: TextIO, log: JointLog | None, targets: list[Target], camera: str | None) -> None:
        self._log, self._camera, self._many = log, camera, len(targets) > 1
        self._count = max(len(target.numbers) for target in targets)
        self._numbered = (self._many or camera is not None) and not (log is not None and "pose_id" in log.columns)
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(self.columns())

    def columns(self) -> list[str]:
        """Names of the columns."""
        numbers = range(1, self._count + 1)
        names = [] if self._log is None else list(self._log.columns)
        names += ["pose_id"] if self._numbered else []
        names += ["camera"] if self._camera is not None else []
        names += ["board"] if self._many else []
        names += [f"{axis}{n}_px" for n in numbers for axis in "uv"]
        return names + [f"s{axis}{n}_px" for n in numbers for axis in "uv"]

    def write(self, view: View, row: int | None, pose: int) -> None:
        """Write a view; ``row`` is its row of the joint log, ``pose`` the number of its picture."""
        found: list[str] = []
        if self._log is not None and row is not None:
            for name, values in self._log.columns.items():
                found += cells(name, [float(values[row])])
        found += [str(pose if row is None else row + 1)] if self._numbered else []
        found += [self._camera] if self._camera is not None else []
        found += [view.board] if self._many else []
        self._writer.writerow(
            found + self._spread(view, view.pixels, PIXEL_DIGITS) + self._spread(view, view.sigmas, SIGMA_DIGITS)
        )

    def _spread(self, view: View, values: Floats, digits: int) -> list[str]:
        spread = [""] * (2 * self._count)
        for place, pair in zip(view.places, values.tolist(), strict=True):
            spread[2 * place : 2 * place + 2] = [f"{value:.{digits}f}" for value in pair]
        return spread
