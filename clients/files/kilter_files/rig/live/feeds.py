"""Pictures as they come: a folder that fills, an MJPEG stream over HTTP, or a camera of this machine."""

from __future__ import annotations

import io
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Condition, Event, Thread
from typing import Any, BinaryIO, Protocol

from kilter_files.ground.errors import FileError, UsageError
from kilter_files.rig.board_layout import opencv
from kilter_files.rig.see.pictures import ENDINGS, MOST_BYTES, Grey, Refusal, RefusedError, read_grey, read_grey_stream

POLL_S = 0.1
PARTIAL_S = 2.0  # for which a file that cannot be read may still be written
PATIENCE_S = 10.0  # without a picture of a stream
AGAIN_S = 1.0
MOST_HEADER = 4096
DEVICE = "/dev/video"

WAIT_S = 0.5


@dataclass(frozen=True)
class Shot:
    """A picture, or why there is none; ``still`` where whoever took it says that the arm rests."""

    name: str
    t_s: float
    grey: Grey | None
    refusal: Refusal | None = None
    still: bool = False


class Feed(Protocol):
    """Where pictures come from."""

    name: str
    passes: bool  # whether pictures pass that nobody looks at

    def shots(self, stop: Event) -> Iterator[Shot | None]:
        """One picture after the other until ``stop``; None while nothing comes."""


def open_feed(source: str) -> Feed:
    """Return the feed of an address, a device or a folder.

    Raises:
        UsageError: neither of them.

    """
    if source.startswith(("http://", "https://")):
        return Stream(source)
    if source.startswith(DEVICE):
        return Device(Path(source))
    if Path(source).is_dir():
        return Folder(Path(source))
    raise UsageError(f"{source}: give a folder, the address of an MJPEG stream (http://...), or a camera ({DEVICE}0).")


class Folder:
    """A folder into which somebody writes pictures; those that are there count first."""

    passes = False

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, str(path)

    def shots(self, stop: Event) -> Iterator[Shot | None]:
        """New pictures in the order of their times; each is taken to be of an arm at rest."""
        done: set[str] = set()
        while not stop.is_set():
            new = [p for p in self._pictures() if p.name not in done]
            for path in new:
                shot = self._shot(path)
                if shot is not None:
                    done.add(path.name)
                yield shot
            if not new:
                yield None
                stop.wait(POLL_S)

    def _pictures(self) -> list[Path]:
        inside = [p for p in self.path.iterdir() if p.suffix.lower() in ENDINGS and not p.name.startswith(".")]
        return sorted(inside, key=lambda p: (p.stat().st_mtime_ns, p.name))

    def _shot(self, path: Path) -> Shot | None:
        try:
            return Shot(str(path), time.monotonic(), read_grey(path), still=True)
        except RefusedError as error:
            if time.time() - path.stat().st_mtime < PARTIAL_S:
                time.sleep(POLL_S)
                return None
            return Shot(str(path), time.monotonic(), None, error.refusal)


class Stream:
    """Pictures of an MJPEG stream (multipart/x-mixed-replace), as network cameras and ROS's web_video_server send them."""

    passes = True

    def __init__(self, address: str) -> None:
        self.name = address

    def shots(self, stop: Event) -> Iterator[Shot | None]:
        """Pictures as they come; where the stream ends or was not there, it is asked for again.

        Raises:
            FileError: it was never there, or is of another kind.

        """
        number, met = 0, False
        while not stop.is_set():
            try:
                with urllib.request.urlopen(self.name, timeout=PATIENCE_S) as answer:  # noqa: S310 (http or https, see feed_of)
                    mark = multipart_boundary(self.name, str(answer.headers.get("Content-Type", "")))
                    for packed in multipart_pictures(answer, mark):
                        if stop.is_set():
                            return
                        number, met = number + 1, True
                        yield _decode_shot(f"{self.name}#{number}", packed)
            except (OSError, urllib.error.URLError) as error:
                if not met:
                    raise FileError(f"{self.name}: sends no pictures: {error}. Open it in a browser first.") from error
            yield None
            stop.wait(AGAIN_S)


def multipart_boundary(name: str, kind: str) -> bytes:
    """Return the line between the parts of a stream.

    Raises:
        FileError: another kind of answer.

    """
    what, _, rest = kind.partition(";")
    key, _, mark = rest.strip().partition("=")
    if what.strip().lower() != "multipart/x-mixed-replace" or key.strip().lower() != "boundary" or not mark:
        raise FileError(f"{name}: is {what or 'of no kind'}, not an MJPEG stream (multipart/x-mixed-replace).")
    return b"--" + mark.strip().strip('"').lstrip("-").encode()


def multipart_pictures(stream: BinaryIO, mark: bytes) -> Iterator[bytes]:
    """Return the pictures between the marks, each no longer than a picture may be.

    Raises:
        OSError: the stream ended or is damaged.

    """
    while True:
        line = stream.readline(MOST_HEADER)
        if not line:
            raise OSError("the stream ended")
        if mark not in line:
            continue
        length: int | None = None
        while (head := stream.readline(MOST_HEADER)).strip():
            key, _, value = head.partition(b":")
            if key.strip().lower() == b"content-length" and value.strip().isdigit():
                length = int(value)
        if length is None or not 0 < length <= MOST_BYTES:
            raise OSError("its parts state no length (Content-Length), or one that no picture has")
        packed = stream.read(length)
        if len(packed) < length:
            raise OSError("the stream ended within a picture")
        yield packed


def _decode_shot(name: str, packed: bytes) -> Shot:
    try:
        return Shot(name, time.monotonic(), read_grey_stream(name, io.BytesIO(packed), len(packed)))
    except RefusedError as error:
        return Shot(name, time.monotonic(), None, error.refusal)


class Device:
    """A camera of this machine, by Video4Linux."""

    passes = True

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, str(path)

    def shots(self, stop: Event) -> Iterator[Shot | None]:
        """Pictures as they come.

        Raises:
            FileError: no such camera, or it is used by another program.

        """
        cv2 = opencv()
        if not self.path.exists():
            raise FileError(f"{self.name}: is not there: `ls {DEVICE}*` lists the cameras of this machine.")
        camera: Any = cv2.VideoCapture(self.name, cv2.CAP_V4L2)
        try:
            if not camera.isOpened():
                raise FileError(
                    f"{self.name}: cannot be opened: another program uses it, or you are not in group video."
                )
            number = 0
            while not stop.is_set():
                there, bgr = camera.read()
                if not there:
                    yield None
                    stop.wait(POLL_S)
                    continue
                number += 1
                grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY) if bgr.ndim == 3 else bgr
                yield Shot(f"{self.name}#{number}", time.monotonic(), grey)
        finally:
            camera.release()


class _Slot:
    """Room for one picture, and for what ended the feed."""

    def __init__(self) -> None:
        self.changed = Condition()
        self.shot: Shot | None = None
        self.error: BaseException | None = None
        self.ended = False

    def fill(self, feed: Feed, stop: Event) -> None:
        """Read the feed to its end."""
        error: BaseException | None = None
        try:
            for shot in feed.shots(stop):
                if shot is not None:
                    with self.changed:
                        self.shot = shot
                        self.changed.notify()
        except BaseException as raised:  # told where pictures are looked at
            error = raised
        with self.changed:
            self.error, self.ended = error, True
            self.changed.notify()


def newest(feed: Feed, stop: Event) -> Iterator[Shot | None]:
    """Pictures of a feed, each the newest there is; None while none comes. A folder's are all looked at."""
    if not feed.passes:
        yield from feed.shots(stop)
        return
    slot = _Slot()
    Thread(target=slot.fill, args=(feed, stop), daemon=True).start()
    while not stop.is_set():
        with slot.changed:
            if slot.shot is None and not slot.ended:
                slot.changed.wait(WAIT_S)
            shot, slot.shot = slot.shot, None
            if shot is None and slot.ended:
                if slot.error is not None:
                    raise slot.error
                return
        yield shot
