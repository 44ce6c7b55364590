"""Bags of ROS 2 (SQLite and MCAP) and ROS 1: the joints of a topic of sensor_msgs/JointState, by time."""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import KilterError, fault, read_head
from kilter_files.ground.later import need, np, rosbag1, rosbag2, typesys

JOINT_STATE = "sensor_msgs/msg/JointState"
METADATA = "metadata.yaml"
COMPRESSED = re.compile(r"^\s*compression_mode:\s*['\"]?([A-Za-z]+)", re.M)
FILES = re.compile(r"^\s*relative_file_paths:\s*\n((?:\s*-\s*.+\n)+)", re.M)
MOST_METADATA = 4 << 20
ROS1 = b"#ROSBAG V2.0"
APART = 0.1  # rad or m between two messages of one stamp: no arm is that fast
AGAIN = "Record it again, or look at it with `ros2 bag info`."

MCAP = b"\x89MCAP0\r\n"
SQLITE = b"SQLite format 3\0"
LARGEST_CHUNK = 256 << 20
HEAD = struct.Struct("<BQ")
CHUNK = struct.Struct("<QQQII")  # first and last time, size unpacked, checksum, length of the compression's name
CHUNK_RECORD, FOOTER_RECORD = 0x06, 0x02
RECORD_AGAIN = "Recover it with `mcap recover`, or record again and let the recorder end by itself."


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag: its name, the type of its messages, and how many there are."""

    name: str
    kind: str
    messages: int


@dataclass(frozen=True)
class BagJoints:
    """Joint positions (n, names) as the messages give them (rad, prismatic m), time from the first, and messages' numbers.

    ``begins_ns`` is when the first was sent, by its stamp, or written where it has none.
    """

    topic: str
    names: tuple[str, ...]
    t_s: Floats
    positions: Floats
    messages: tuple[int, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    begins_ns: int


def topics(path: Path) -> list[BagTopic]:
    """List the topics of a bag.

    Raises:
        FileError: no bag, a damaged or a packed one.
        MissingPackageError: rosbags is not installed.

    """
    with _open_bag(path) as reader:
        return [BagTopic(c.topic, c.msgtype, c.msgcount) for c in reader.connections]


def read_bag(path: Path, topic: str | None = None, wanted: Sequence[str] = (), likely: Sequence[str] = ()) -> BagJoints:
    """Read joint positions of the messages that hold ``wanted``; without it of ``likely``, if the first message has them.

    Raises:
        FileError: no such topic, several to choose from, messages of different joints, time that goes back.

    """
    with _open_bag(path) as reader, _translate_library_errors(path):
        chosen = _topic(path, reader, topic)
        kept = _Kept(path, tuple(wanted), tuple(likely))
        for number, state, written in _states(reader, chosen):
            kept.add_message(number, state, written)
    if not kept.numbers:
        what = f"no message of {chosen} holds {', '.join(wanted) or 'a joint'}"
        raise fault(path, what, "Choose another topic (--topic) or other joints (--joint-order).")
    twice, merged = kept.merge_equal_times()
    warnings = [f"{kept.left} messages left out: they do not hold {', '.join(kept.names)}"] if kept.left else []
    warnings += [f"{twice} messages left out: they repeat the one before"] if twice else []
    warnings += (
        [f"{merged} messages merged: their stamp is that of the one before, their joints averaged"] if merged else []
    )
    notes = (f"joints from {chosen}, {len(kept.numbers)} messages; speeds and efforts are left out",)
    return BagJoints(
        chosen, kept.names, kept.t_s, kept.positions, tuple(kept.numbers), notes, tuple(warnings), kept.times[0]
    )


@contextmanager
def _open_bag(path: Path) -> Iterator[Any]:
    place = _place(path)
    for file in sorted(place.iterdir()) if place.is_dir() else [place]:
        head = b"" if file.is_dir() else read_head(file, 16)
        if head.startswith(MCAP):
            check_mcap(file)
        elif head.startswith(SQLITE):
            check_sqlite(file)
    need(f"{path}: ROS bags need", "rosbags")
    with _translate_library_errors(path):
        reader: Any = rosbag1.Reader(place) if _is_ros1(place) else rosbag2.Reader(place)
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


def _is_ros1(place: Path) -> bool:
    return not place.is_dir() and read_head(place, len(ROS1)).startswith(ROS1)


def _place(path: Path) -> Path:
    """The folder of a bag that has a description, else the single file."""
    folder = path if path.is_dir() else path.parent
    description = folder / METADATA
    if not description.is_file():
        if path.is_dir():
            raise fault(
                path, "is a folder without metadata.yaml: no bag", "Name the bag's folder, or its .mcap or .db3."
            )
        return path
    text = read_head(description, MOST_METADATA).decode("utf-8", "replace")
    packed = COMPRESSED.search(text)
    if packed and packed[1].lower() != "none":
        by = "its files: unpack them (`zstd -d`) and name one" if packed[1].lower() == "file" else "its messages"
        raise fault(path, f"is packed by {by}", "Or write it again with `ros2 bag convert`, without compression.")
    listed = FILES.search(text)
    named = path.is_dir() or path.name == METADATA or (listed is not None and path.name in listed[1])
    return folder if named else path


@contextmanager
def _translate_library_errors(path: Path) -> Iterator[None]:
    """Whatever the library stumbles over in a damaged bag is that bag's fault."""
    try:
        yield
    except KilterError:
        raise
    except MemoryError as error:
        raise fault(path, "claims more data than fits into memory", AGAIN) from error
    except Exception as error:  # rosbags lets struct.error, KeyError, AssertionError, apsw's errors and more through
        raise fault(path, f"is damaged: {type(error).__name__} {str(error)[:120]}", AGAIN) from error


@contextmanager
def bag_messages(
    path: Path, kinds: Sequence[str], topic: str | None = None
) -> Iterator[tuple[str, int, Iterator[tuple[Any, int]]]]:
    """The topic of pictures that is asked for or the only one, how many messages it has, and them with their times (ns).

    Raises:
        FileError: no bag, a damaged one, no such topic, several to choose from.

    """
    with _open_bag(path) as reader, _translate_library_errors(path):
        found = {c.topic: c.msgtype for c in reader.connections if c.msgtype in kinds and c.msgcount}
        if topic is not None and topic not in found:
            remedy = f"Those with pictures are {', '.join(found)}." if found else "It holds no pictures at all."
            raise fault(path, f"has no topic {topic!r} of {' or '.join(kinds)}", remedy)
        if topic is None and len(found) != 1:
            what = f"pictures come from {', '.join(sorted(found))}" if found else "holds no pictures"
            raise fault(path, what, "Choose one (--topic)." if found else f"Record {' or '.join(kinds)} too.")
        chosen = topic or next(iter(found))
        count = sum(c.msgcount for c in reader.connections if c.topic == chosen)
        messages = ((message, written) for _, message, written in _messages(reader, chosen, found[chosen]))
        yield chosen, count, messages


def _topic(path: Path, reader: Any, topic: str | None) -> str:
    found = sorted({c.topic for c in reader.connections if c.msgtype == JOINT_STATE and c.msgcount})
    if topic is not None and topic not in found:
        remedy = f"Those with joint states are {', '.join(found)}." if found else "It holds no joint states at all."
        raise fault(path, f"has no topic {topic!r} of {JOINT_STATE}", remedy)
    if topic is None and len(found) != 1:
        what = f"joint states come from {', '.join(found)}" if found else f"holds no messages of {JOINT_STATE}"
        raise fault(path, what, "Choose one (--topic)." if found else "Record /joint_states too.")
    return topic or found[0]


def _states(reader: Any, topic: str) -> Iterator[tuple[int, Any, int]]:
    """Return number, message and time of writing [ns] of a topic's messages."""
    return _messages(reader, topic, JOINT_STATE)


def _messages(reader: Any, topic: str, kind: str) -> Iterator[tuple[int, Any, int]]:
    first = isinstance(reader, rosbag1.Reader)
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if first else typesys.Stores.ROS2_HUMBLE)
    read = store.deserialize_ros1 if first else store.deserialize_cdr
    chosen = [c for c in reader.connections if c.topic == topic and c.msgtype == kind]
    for number, (_, written, raw) in enumerate(reader.messages(chosen), 1):
        yield number, read(raw, kind), written


class _Kept:
    """The messages that are taken: rows of positions with their times."""

    def __init__(self, path: Path, wanted: tuple[str, ...], likely: tuple[str, ...]) -> None:
        self.path, self.names, self.likely = path, wanted, likely
        self.chosen = bool(wanted)
        self.stamped: bool | None = None
        self.times, self.values = array("q"), array("d")
        self.numbers: list[int] = []
        self.left = 0

    def add_message(self, number: int, state: Any, written: int) -> None:
        """Take a message, or count it as left out."""
        place = {name: i for i, name in enumerate(state.name)}
        if not self.names and place:
            self.chosen = bool(self.likely) and set(self.likely) <= set(place)
            self.names = self.likely if self.chosen else tuple(place)
        if place and not self.chosen and set(place) != set(self.names):
            raise _mixed_joints_fault(self.path, number, self.names, state.name)
        if not place or not all(name in place for name in self.names):
            self.left += 1
            return
        row = [float(state.position[place[name]]) for name in self.names]
        if not np.isfinite(row).all():
            what = f"the position of {self.names[int(np.argmin(np.isfinite(row)))]!r} is not a number"
            raise fault(self.path, what, "Cut the bag there, or record again.", message=number)
        stamp = int(state.header.stamp.sec) * 10**9 + int(state.header.stamp.nanosec)
        if self.stamped is None:
            self.stamped = stamp > 0
        self.times.append(stamp if self.stamped else written)
        self.values.extend(row)
        self.numbers.append(number)

    @property
    def t_s(self) -> Floats:
        """Seconds from the first message."""
        ns = np.array(self.times, dtype=np.int64)
        return np.asarray((ns - ns[0]) * 1e-9)

    @property
    def positions(self) -> Floats:
        """Positions (n, joints)."""
        return np.array(self.values).reshape(-1, len(self.names))

    def merge_equal_times(self) -> tuple[int, int]:
        """Leave out messages that say the same again and average others of one stamp; count both.

        Raises:
            FileError: the clock goes back, or one stamp has joints that no motion explains.

        """
        times, positions = np.array(self.times, dtype=np.int64), self.positions
        step = np.diff(times)
        if (step < 0).any():
            what = "its clock goes back: two recordings, or two publishers"
            number = self.numbers[int(np.argmax(step < 0)) + 1]
            raise fault(self.path, what, "Split the bag there (`ros2 bag convert`).", message=number)
        again = np.concatenate([[False], (step == 0) & (positions[1:] == positions[:-1]).all(axis=1)])
        times, positions = times[~again], positions[~again]
        first = np.flatnonzero(np.diff(times, prepend=times[0] - 1))
        counts = np.diff(first, append=len(times))
        apart = np.maximum.reduceat(positions, first) - np.minimum.reduceat(positions, first)
        if (far := apart.max(axis=1) > APART).any():
            k = int(np.argmax(far))
            what = f"{counts[k]} messages have one stamp and joints up to {apart[k].max():.2g} rad or m apart"
            number = int(np.array(self.numbers)[~again][first[k] + 1])
            remedy = "Record one publisher, with a clock that runs."
            raise fault(self.path, what, remedy, message=number)
        self.values = array("d", (np.add.reduceat(positions, first) / counts[:, None]).ravel().tolist())
        self.times = array("q", times[first].tolist())
        self.numbers = np.array(self.numbers)[~again][first].tolist()
        return int(again.sum()), len(times) - len(first)


def _mixed_joints_fault(path: Path, number: int, names: Sequence[str], other: Sequence[str]) -> Exception:
    what = f"its messages hold different joints ({', '.join(names)}; here {', '.join(other)})"
    return fault(path, what, "Name the arm's joints from the base to the tool (--joint-order a,b,c).", message=number)


def check_mcap(path: Path) -> None:
    """Follow the records from the first to the end and unpack each chunk no further than it says.

    Raises:
        FileError: cut off, glued, or a chunk that unpacks to more than it states or than is sensible.

    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        at = len(MCAP)
        while True:
            stream.seek(at)
            head = stream.read(HEAD.size)
            if len(head) < HEAD.size:
                raise fault(path, "is cut off: its end is missing", RECORD_AGAIN, byte=at)
            kind, length = HEAD.unpack(head)
            if at + HEAD.size + length > size:
                raise fault(path, f"is cut off: a record states {length} bytes", RECORD_AGAIN, byte=at)
            if kind == CHUNK_RECORD:
                _check_chunk(path, stream, at, length)
            at += HEAD.size + length
            if kind == FOOTER_RECORD:
                break
        stream.seek(at)
        if stream.read(len(MCAP)) != MCAP or at + len(MCAP) != size:
            raise fault(path, "goes on behind its end: is another file appended to it", RECORD_AGAIN, byte=at)


def check_sqlite(path: Path) -> None:
    """Compare the size with the pages the file states.

    Raises:
        FileError: cut off.

    """
    head = read_head(path, 100)
    if len(head) < 100:
        raise fault(path, "is cut off", "Copy it again.", byte=len(head))
    page, pages = struct.unpack_from(">H", head, 16)[0], struct.unpack_from(">I", head, 28)[0]
    page = 65536 if page == 1 else page
    size = path.stat().st_size
    if pages and size < page * pages:
        what = f"is cut off: it states {pages} pages ({page * pages} bytes), {size} bytes are there"
        raise fault(path, what, "Copy it again.", byte=size)


def _check_chunk(path: Path, stream: BinaryIO, at: int, length: int) -> None:
    head = stream.read(CHUNK.size)
    if len(head) < CHUNK.size:
        raise fault(path, "a chunk is shorter than its head", RECORD_AGAIN, byte=at)
    _, _, unpacked, _, named = CHUNK.unpack(head)
    if unpacked > LARGEST_CHUNK:
        what = f"a chunk claims to unpack to {unpacked} bytes"
        raise fault(path, what, f"Record with chunks below {LARGEST_CHUNK >> 20} MB.", byte=at)
    packing = stream.read(min(named, 16)).decode("latin-1")
    stated = stream.read(8)
    if named > 16 or len(stated) < 8:
        raise fault(path, "a chunk has an unknown compression", RECORD_AGAIN, byte=at)
    packed = struct.unpack("<Q", stated)[0]
    if packed != length - CHUNK.size - named - 8:
        raise fault(path, "a chunk's size is not that of its record", RECORD_AGAIN, byte=at)
    if _unpacked_size(path, stream.read(packed), packing, unpacked, at) != unpacked:
        raise fault(path, f"a chunk does not unpack to the {unpacked} bytes it states", RECORD_AGAIN, byte=at)


def _unpacked_size(path: Path, content: bytes, packing: str, limit: int, at: int) -> int:
    """Return how many bytes ``content`` unpacks to, counted no further than one beyond ``limit``."""
    if not packing:
        return len(content)
    unpack = _unpacker(path, packing, at)
    try:
        return len(unpack.decompress(content, limit + 1))
    except Exception as error:  # zstd and lz4 have their own kinds of errors, and RuntimeError
        raise fault(path, f"a chunk cannot be unpacked ({str(error)[:80]})", RECORD_AGAIN, byte=at) from error


def _unpacker(path: Path, packing: str, at: int) -> Any:
    if packing == "lz4":
        return need(f"{path}: This recording needs", "lz4", "lz4.frame").LZ4FrameDecompressor()
    if packing == "zstd":
        return need(f"{path}: This recording needs", "backports.zstd").ZstdDecompressor()
    raise fault(
        path, f"a chunk is compressed with {packing!r}", "Record with zstd, lz4 or without compression.", byte=at
    )
