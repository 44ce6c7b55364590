"""Pictures from files, folders and videos, one at a time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from kilter_files.ground.errors import FileError, UsageError, fault
from kilter_files.rig.board.layout import opencv
from kilter_files.rig.see.pictures import ENDINGS, Grey, Refusal, RefusedError, check_size, read_grey

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
