"""Pictures from files, folders and videos, one at a time.

Which row of the joint log belongs to a picture.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, Protocol

import numpy as np

from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.ground.errors import FileError, UsageError, fault
from kilter_files.ground.units import column_unit
from kilter_files.rig.board_layout import opencv
from kilter_files.rig.see.pictures import ENDINGS, Grey, Refusal, RefusedError, check_size, read_grey
from kilter_files.tables.table import JointLog, checked_log

VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v")
DAMAGED = "Copy it again, or have it written as pictures."


@dataclass(frozen=True)
class Frame:
    """A picture, or why there is none; ``t_s`` is its time in a video."""

    name: str
    grey: Grey | None
    refusal: Refusal | None = None
    t_s: float | None = None
    video: str | None = None


class Pictures(Protocol):
    """Where pictures come from, one at a time."""

    @property
    def videos(self) -> Sequence[Path]:
        """Those that are videos."""

    def count(self) -> int:
        """About how many pictures there are."""

    def frames(self, size: tuple[int, int] | None = None) -> Iterator[Frame]:
        """Read one picture after the other; ``size`` is the camera's."""


@dataclass(frozen=True)
class Source:
    """Pictures in the order of their names, and videos."""

    files: tuple[Path, ...]
    every: int = 1

    @property
    def videos(self) -> list[Path]:
        """Those that are videos."""
        return [path for path in self.files if path.suffix.lower() in VIDEOS]

    def count(self) -> int:
        """About how many pictures there are."""
        return sum(_frames(path) // self.every if path.suffix.lower() in VIDEOS else 1 for path in self.files)

    def frames(self, size: tuple[int, int] | None = None) -> Iterator[Frame]:
        """Read one picture after the other; ``size`` is the camera's."""
        for path in self.files:
            if path.suffix.lower() in VIDEOS:
                yield from _video(path, self.every, size)
            else:
                yield _picture(path, size)


def gather_source(paths: list[Path], every: int = 1) -> Source:
    """Gather pictures and videos: folders give theirs, in the order of the numbers in their names.

    Raises:
        UsageError: none at all.
        FileError: a path that is not there.

    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = [p for p in path.iterdir() if p.is_file() and p.suffix.lower() in (*ENDINGS, *VIDEOS)]
            found += sorted(inside, key=lambda p: _by_number(p.name))
        elif path.exists():
            found.append(path)
        else:
            raise FileError(f"{path}: is not there.", file=str(path))
    if not found:
        raise UsageError(f"{paths[0]}: has no picture ({' '.join(ENDINGS)}) and no video ({' '.join(VIDEOS)}).")
    return Source(tuple(found), every)


def _by_number(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def _picture(path: Path, size: tuple[int, int] | None) -> Frame:
    try:
        return Frame(str(path), read_grey(path, size))
    except RefusedError as error:
        return Frame(str(path), None, error.refusal)


def _open_video(path: Path) -> Any:
    cv2 = opencv()
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not video.isOpened():
        raise fault(path, "is not a video that can be read", DAMAGED)
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def _frames(path: Path) -> int:
    cv2 = opencv()
    video = _open_video(path)
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    video.release()
    return max(count, 0)


def _video(path: Path, every: int, size: tuple[int, int] | None) -> Iterator[Frame]:
    cv2 = opencv()
    video = _open_video(path)
    try:
        stated = int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))
        check_size(str(path), stated, size)
        number = 0
        while video.grab():
            if number % every == 0:
                name, t_s = f"{path}:{number + 1}", float(video.get(cv2.CAP_PROP_POS_MSEC)) / 1000
                there, bgr = video.retrieve()
                if there:
                    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY) if bgr.ndim == 3 else bgr
                    yield Frame(name, grey, None, t_s, str(path))
                else:
                    yield Frame(
                        name, None, Refusal(name, "picture_unreadable", "this frame is damaged"), t_s, str(path)
                    )
            number += 1
    except RefusedError as error:
        yield Frame(str(path), None, error.refusal, None, str(path))
    finally:
        video.release()


PICTURE = "picture"
MOST_APART_S = 0.1
REMEDY = "Add a column picture with the file's name to the joint log."


@dataclass
class Poses:
    """Rows of a joint log by picture: ``by`` name, time or order; ``used`` are those that had a picture."""

    log: JointLog
    by: str
    names: dict[str, int]
    starts_s: float = 0.0
    used: set[int] = field(default_factory=set)
    continuous: bool = False  # a recording, most rows of which have no picture

    def claim_row(self, frame: Frame, number: int) -> int | None:
        """Row of a picture, the ``number``-th of all from 0; None: it has none."""
        row = self._row(frame, number)
        if row is not None:
            self.used.add(row)
        return row

    def _row(self, frame: Frame, number: int) -> int | None:
        if self.by == "name":
            path = PurePath(frame.name)
            return next((self.names[key] for key in (frame.name, path.name, path.stem) if key in self.names), None)
        if self.by == "time":
            times = self.log.t_s
            if times is None or frame.t_s is None:
                return None
            apart = np.abs(times - self.starts_s - frame.t_s)
            return int(apart.argmin()) if apart.min() <= MOST_APART_S else None
        return number if number < len(self.log) else None

    def unused_rows(self) -> list[int]:
        """Rows without a picture, numbered from 1; none of a recording."""
        if self.continuous:
            return []
        return [row + 1 for row in range(len(self.log)) if row not in self.used]


def read_poses(path: Path, pictures: int, videos: bool, starts_s: float = 0.0) -> Poses:
    """Read the joint log of pictures.

    By the column ``picture`` where there is one, by ``t_s`` for videos, else in order, if there are as many.

    Raises:
        FileError: as a joint log, a picture named twice, a video without times, other counts.

    """
    named = _with_names(path)
    if named is not None:
        log, names = named
        return Poses(log, "name", names)
    log = read_joint_log(path)
    if videos:
        if log.t_s is None:
            raise fault(path, "has no t_s, by which frames of a video are found", "Add the time of every pose, t_s.")
        return Poses(log, "time", {}, starts_s)
    if len(log) != pictures:
        what = f"has {len(log)} rows, and there are {pictures} pictures"
        raise FileError(f"{path}: {what}. {REMEDY}", code="joints_missing", file=str(path))
    return Poses(log, "order", {})


def _with_names(path: Path) -> tuple[JointLog, dict[str, int]] | None:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.reader(stream)
            head = [name.strip() for name in next(rows, [])]
            if PICTURE not in head:
                return None
            body = [(rows.line_num, row) for row in rows if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error):
        return None  # the reader of joint logs says what is wrong
    lines = [line for line, _ in body]
    for line, row in body:
        if len(row) != len(head):
            raise fault(path, f"has {len(row)} cells, and the head {len(head)}", "Mend the row.", line=line)
    columns = {name: _numbers(path, name, k, body) for k, name in enumerate(head) if name != PICTURE}
    names: dict[str, int] = {}
    for number, (line, row) in enumerate(body):
        name = row[head.index(PICTURE)].strip()
        if name in names:
            raise fault(path, f"{name} is named twice", "Give every picture one row.", line=line, column=PICTURE)
        names[name] = number
    return checked_log(path, columns, lines), names


def _numbers(path: Path, name: str, k: int, body: list[tuple[int, list[str]]]) -> np.ndarray:
    if column_unit(name) is None:
        what = "is not a contract column such as q1_deg or t_s"
        raise fault(path, what, "Rename it or leave it out.", line=1, column=name)
    values = []
    for line, row in body:
        try:
            values.append(float(row[k]) if row[k].strip() else np.nan)
        except ValueError:
            raise fault(path, f"{row[k]!r} is not a number", "Mend the cell.", line=line, column=name) from None
    return np.array(values)
