"""Pictures from a bag of ROS 2 or ROS 1, one of each pose at which the arm rests, with the joints of the same bag."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.formats.joints.bag import METADATA, bag_messages
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.rig.board_layout import opencv
from kilter_files.rig.see.pictures import Grey, Refusal, RefusedError, check_size, read_grey_stream
from kilter_files.rig.see.sources import Frame, Poses
from kilter_files.tables.table import JointLog

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
ENDINGS = (".mcap", ".db3", ".bag")
PLAIN = {"mono8": 1, "8UC1": 1, "bgr8": 3, "rgb8": 3, "8UC3": 3, "bgra8": 4, "rgba8": 4, "mono16": 2, "16UC1": 2}
YUV = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}  # where in each pair of bytes the grey is
BAYER = {
    "bayer_rggb8": "BG",
    "bayer_bggr8": "RG",
    "bayer_gbrg8": "GR",
    "bayer_grbg8": "GB",
}  # OpenCV names the second row
REST_S, REST_RAD, REST_M = 0.25, 4e-4, 1e-4  # before and after a picture; what an arm at rest may move by
ANOTHER_RAD, ANOTHER_M = 0.01, 0.001  # from the pose of the picture before


def is_bag(path: Path) -> bool:
    """Whether a path is a bag, by its name or its metadata."""
    return path.suffix.lower() in ENDINGS or path.name == METADATA or (path.is_dir() and (path / METADATA).is_file())


@dataclass(frozen=True)
class BagPictures:
    """The pictures of a topic of a bag; ``log`` are its joints, ``begins_ns`` when their time is zero."""

    path: Path
    topic: str | None
    log: JointLog
    begins_ns: int
    every: int = 1
    videos: tuple[Path, ...] = ()

    def count(self) -> int:
        """How many pictures there are."""
        with bag_messages(self.path, (IMAGE, COMPRESSED), self.topic) as (_, count, _):
            return count // self.every

    def frames(self, size: tuple[int, int] | None = None) -> Iterator[Frame]:
        """Read a picture of each pose at which the arm rests; ``size`` is the camera's."""
        before: Floats | None = None
        with bag_messages(self.path, (IMAGE, COMPRESSED), self.topic) as (topic, _, messages):
            for number, (message, written) in enumerate(messages, 1):
                stamp = int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)
                t_s = ((stamp or written) - self.begins_ns) * 1e-9
                if number % self.every or not self.rests(t_s):
                    continue
                q = self._q[self._nearest(t_s)]
                if before is not None and not np.any(np.abs(q - before) > self._limits(ANOTHER_RAD, ANOTHER_M)):
                    continue
                frame = _frame(f"{self.path}:{topic}:{number}", message, size, t_s)
                if frame.refusal is None:
                    before = q
                yield frame

    def poses(self) -> Poses:
        """Which row of the joints belongs to a picture: the one nearest in time. Most rows have none."""
        return Poses(self.log, "time", {}, continuous=True)

    def rests(self, t_s: float) -> bool:
        """Whether no joint moves a moment before and after."""
        times = self._times
        near = slice(*np.searchsorted(times, (t_s - REST_S, t_s + REST_S)))
        q = self._q[near]
        if len(q) < 2 or times[near][0] > t_s or times[near][-1] < t_s:
            return False
        return bool(np.all(np.ptp(q, axis=0) <= self._limits(REST_RAD, REST_M)))

    @property
    def _times(self) -> Floats:
        assert self.log.t_s is not None
        return self.log.t_s

    @cached_property
    def _q(self) -> Floats:
        return self.log.q()

    def _limits(self, rad: float, m: float) -> Floats:
        return np.array([m if name.endswith("_m") else rad for name in self.log.joints])

    def _nearest(self, t_s: float) -> int:
        """The row nearest in time, the first of those equally near. The times of a joint log ascend."""
        times = self._times
        after = int(np.searchsorted(times, t_s))  # the first at t_s or later, so the first of rows of one time
        if after == len(times) or (after and t_s - times[after - 1] <= times[after] - t_s):
            return int(np.searchsorted(times, times[after - 1]))
        return after


def pictures_of_bag(path: Path, topic: str | None, log: JointLog, every: int = 1) -> BagPictures:
    """Open a bag of pictures with its joints.

    Raises:
        FileError: no bag, no such topic, several to choose from.

    """
    if log.t_s is None or log.begins_ns is None:
        raise fault(path, "has joints without times", "Record /joint_states with its stamps.")
    found = BagPictures(path, topic, log, log.begins_ns, every)
    found.count()
    return found


def _frame(name: str, message: Any, size: tuple[int, int] | None, t_s: float) -> Frame:
    try:
        with _translate_library_errors(name):
            grey = (
                _decode_compressed(name, message, size)
                if hasattr(message, "format")
                else _decode_raw(name, message, size)
            )
    except RefusedError as error:
        return Frame(name, None, error.refusal, t_s)
    return Frame(name, grey, None, t_s)


@contextmanager
def _translate_library_errors(name: str) -> Iterator[None]:
    try:
        yield
    except RefusedError:
        raise
    except Exception as error:  # whatever NumPy and OpenCV make of a message that contradicts itself
        raise RefusedError(Refusal(name, "picture_unreadable", f"is damaged: {type(error).__name__}")) from error


def _decode_compressed(name: str, message: Any, size: tuple[int, int] | None) -> Grey:
    return read_grey_stream(name, io.BytesIO(bytes(message.data)), len(message.data), size)


def _decode_raw(name: str, message: Any, size: tuple[int, int] | None) -> Grey:
    width, height, step, kind = int(message.width), int(message.height), int(message.step), str(message.encoding)
    check_size(name, (width, height), size)
    deep = PLAIN.get(kind, 2 if kind in YUV else 1 if kind in BAYER else 0)
    if not deep:
        known = ", ".join((*PLAIN, *YUV, *BAYER))
        raise RefusedError(Refusal(name, "picture_unreadable", f"has the encoding {kind!r}, and read are {known}"))
    if step < width * deep or len(message.data) < height * step:
        what = f"states {width} x {height} {kind} and has {len(message.data)} bytes"
        raise RefusedError(Refusal(name, "picture_unreadable", what))
    raw = np.asarray(message.data, dtype=np.uint8)[: height * step].reshape(height, step)[:, : width * deep]
    return _grey(raw, kind, width, height, big=bool(message.is_bigendian))


def _grey(raw: Grey, kind: str, width: int, height: int, big: bool) -> Grey:
    cv2 = opencv()
    if kind in YUV:
        return np.ascontiguousarray(raw[:, YUV[kind] :: 2])
    if kind in BAYER:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(raw), getattr(cv2, f"COLOR_Bayer{BAYER[kind]}2GRAY")))
    if PLAIN[kind] == 1:
        return np.ascontiguousarray(raw)
    if PLAIN[kind] == 2:
        deep = np.ascontiguousarray(raw).view(">u2" if big else "<u2").reshape(height, width)
        bits = max(8, int(deep.max(initial=0)).bit_length())  # 10 or 12 bits in 16 would be dark
        return np.asarray(deep >> (bits - 8), dtype=np.uint8)
    colour = np.ascontiguousarray(raw).reshape(height, width, PLAIN[kind])
    order = "RGB" if kind.startswith("rgb") else "BGR"
    return np.asarray(cv2.cvtColor(colour, getattr(cv2, f"COLOR_{order}{'A' if PLAIN[kind] == 4 else ''}2GRAY")))
