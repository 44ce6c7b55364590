"""Views that were taken: pictures in a folder, and the joints of each in a table beside them."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, field
from pathlib import Path

from kilter_files.ground.errors import FileError
from kilter_files.ground.units import column_unit
from kilter_files.rig.board.opencv import opencv
from kilter_files.rig.live.feeds import Shot
from kilter_files.rig.see.views import View

JOINTS, PICTURE = "joints.csv", "picture"
NUMBERED = re.compile(r"view(\d+)\.png")


@dataclass
class Taken:
    """Where views go: ``folder`` None leaves pictures where they are. ``joints`` is a file that says where the arm is now."""

    folder: Path | None
    joints: Path | None = None
    last: list[View] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    noted: dict[str, str] | None = None

    def __len__(self) -> int:
        return len(self.names)

    def add(self, shot: Shot, views: list[View], elsewhere: bool) -> str:
        """Keep a picture and its joints, and say so; ``elsewhere`` says that the board has moved since the last view.

        Raises:
            FileError: joints that cannot be read or are those of the last view, or a folder that cannot be written to.

        """
        row = None if self.joints is None else read_row(self.joints)
        if elsewhere and row is not None and row == self.noted:
            raise FileError(
                f"{self.joints}: has the joints of {self.names[-1]}, and the board has moved since: the view was not taken. "
                "Let your controller keep the file current."
            )
        name = shot.name
        if self.folder is not None:
            name = self._written(shot)
            if row is not None:
                self._append({PICTURE: name} | row)
        self.names.append(name)
        self.last, self.noted = views, row
        return f"took {name}" + ("" if row is None else " with its joints")

    def _written(self, shot: Shot) -> str:
        assert self.folder is not None
        assert shot.grey is not None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            there = [int(m[1]) for p in self.folder.iterdir() if (m := NUMBERED.fullmatch(p.name))]
            name = f"view{max(there, default=0) + 1:04d}.png"
            with (self.folder / name).open("xb") as file:
                file.write(bytes(opencv().imencode(".png", shot.grey)[1]))
        except OSError as error:
            raise FileError(f"{self.folder}: cannot be written to: {error.strerror or error}.") from error
        return name

    def _append(self, row: dict[str, str]) -> None:
        assert self.folder is not None
        path = self.folder / JOINTS
        new = not path.exists()
        if not new:
            head = path.read_text(encoding="utf-8").partition("\n")[0].strip().split(",")
            if head != list(row):
                raise FileError(f"{path}: has the columns {','.join(head)}, and the joints now {','.join(row)}.")
        with path.open("a", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            if new:
                writer.writerow(row)
            writer.writerow(row.values())


def read_row(path: Path) -> dict[str, str]:
    """The joints in a file with a head of contract columns; its last row counts.

    Raises:
        FileError: not there, no row, a column that is none, or a cell that is not a number.

    """
    try:
        rows = [row for row in csv.reader(path.read_text(encoding="utf-8-sig").splitlines()) if any(row)]
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read: the view was not taken.") from error
    if len(rows) < 2 or len(rows[0]) != len(rows[-1]):
        raise FileError(f"{path}: has no whole row of joints: give a head (q1_deg,q2_deg,...) and a row.")
    found = dict(zip((name.strip() for name in rows[0]), (cell.strip() for cell in rows[-1]), strict=True))
    for name, cell in found.items():
        if column_unit(name) is None:
            raise FileError(f"{path}: column {name!r} is not a contract column such as q1_deg.")
        try:
            float(cell)
        except ValueError:
            raise FileError(f"{path}: {cell!r} in column {name!r} is not a number.") from None
    return found
