"""What a reader of files states: which files it recognises, how it describes one, and how it reads it.

A column of numbers, described.

What a ZIP archive holds, by the names in it: nothing is unpacked, and whoever gave it is told what to do with its parts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, fault, read_head
from kilter_files.ground.later import np
from kilter_files.ground.text_layout import TextLayout, lines_in_cells, sniff
from kilter_files.ground.workbook_formulas import member_names
from kilter_files.tables.source import Layout

if TYPE_CHECKING:
    from kilter_files.ground.arrays import Floats
    from kilter_files.tables.recording import Recording


Document = dict[str, Any]
Read = TypeVar("Read", covariant=True)

UPLOAD, MAP, DEVICE, PRESET, MATCH = "upload", "upload --map", "upload --device", "upload --preset", "match"
USES = (MAP, DEVICE, PRESET, MATCH, UPLOAD)  # in the order in which they are listed
START_BYTES = 512


@dataclass(frozen=True)
class LogHints:
    """What the person says of a log: the topic of a bag, and its joints from the base to the tool.

    ``order`` are joint names; a prismatic joint is ``name:m``. ``likely`` is used when the log has all of them.
    Of a LeRobot data set the ``calibration`` and its ``norm_mode`` say what its numbers mean; ``zero`` "old" says that they
    are degrees from where the arm is stretched out.
    """

    topic: str | None = None
    order: Sequence[str] = ()
    likely: Sequence[str] = ()
    calibration: Path | None = None
    norm_mode: str | None = None
    zero: str = "new"


@dataclass(frozen=True)
class Hints:
    """What the person says of a file that does not say it itself.

    ``joints`` are columns of another file, a row for each of its. ``robot`` are the joints of the arm, prismatic ones with
    ``:m`` at the end.
    """

    rate_hz: float | None = None
    allow_cut: bool = False
    preset: str = "generic"
    euler: str | None = None
    unit: str | None = None
    log: LogHints = field(default_factory=LogHints)
    layout: Layout = field(default_factory=Layout)
    joints: Mapping[str, Floats] | None = None
    robot: Sequence[str] = ()

    @property
    def say_points(self) -> bool:
        """Whether the person says that it is an export of points."""
        return self.preset != "generic" or self.euler is not None


NO_LOG_HINTS = LogHints()
NO_HINTS = Hints()


@dataclass
class Head:
    """The beginning of a file, and what it tells; each is looked at once, when a reader asks for it."""

    path: Path
    hints: Hints = field(default_factory=Hints)
    found: dict[str, Any] = field(default_factory=dict)  # by readers that took a closer look, for the next who asks

    @property
    def ending(self) -> str:
        """The ending in small letters, with its dot."""
        return self.path.suffix.lower()

    @cached_property
    def start(self) -> bytes:
        """The first bytes; none of a folder."""
        return b"" if self.path.is_dir() else read_head(self.path, START_BYTES)

    @cached_property
    def layout(self) -> TextLayout | None:
        """How a text with one row in a line is laid out; None where it is not such a text."""
        if lines_in_cells(self.path):
            return None
        try:
            return sniff(self.path)
        except FileError:
            return None


class Reader(ABC, Generic[Read]):
    """A format: what it is for people, the command that takes it, the endings it is known by, and how it is read.

    A format that first bytes show has a noun, ``is_a``; where something else was wanted, ``instead`` says what to do with it.
    Packages that a format needs are imported when it is read.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    use: ClassVar[str]
    endings: ClassVar[tuple[str, ...]] = ()
    is_a: ClassVar[str] = ""
    instead: ClassVar[str] = ""

    @abstractmethod
    def recognises(self, head: Head) -> bool:
        """Tell whether a file is of this format, by its content before its name."""

    @abstractmethod
    def describe(self, head: Head) -> Document:
        """Say what is understood of a file: ``problems`` would be refused, ``warnings`` are to be looked at.

        Raises:
            FileError: it cannot be read, with place and remedy.

        """

    @abstractmethod
    def read(self, path: Path, hints: Hints = NO_HINTS) -> Read:
        """Read a file.

        Raises:
            FileError: it is not what it should be, with place and remedy.

        """

    def names_and_titles(self) -> Iterator[tuple[str, str]]:
        """Names and titles in the list of formats."""
        yield self.name, self.title


class RecordingReader(Reader["Recording"]):
    """A format of recordings of markers."""

    use = MATCH

    @abstractmethod
    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames; the unit of the hints is the one of the coordinates, whatever the file states."""

    def describe(self, head: Head) -> Document:
        """Frames, and gaps and noise of each marker."""
        from kilter_files.formats.marker_header import describe_recording

        return describe_recording(self.read(head.path, head.hints))


def column(name: str, unit: str | None, values: Floats) -> Document:
    """Describe a column of numbers: unit, range, and how many cells are empty."""
    known = values[~np.isnan(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (None, None)
    return {"name": name, "unit": unit, "low": low, "high": high, "empty": len(values) - len(known)}


ZIP = b"PK\x03\x04"
DATA_SET = "meta/info.json"
PICTURES = (".png", ".jpg", ".jpeg")
MOST_NAMED = 3


def of_zip(path: Path) -> FileError:
    """Return the error of an archive that was given for a file of measurements."""
    try:
        names = [name for name in member_names(path) if not name.endswith("/")]
    except ValueError:
        return fault(
            path,
            "is a ZIP archive or a spreadsheet",
            "Unpack it; where that fails it is damaged: copy or export it again.",
        )
    if any(name == DATA_SET or name.endswith(f"/{DATA_SET}") for name in names):
        return fault(
            path,
            "is a ZIP archive of a LeRobot data set",
            "Unpack it, and match its folder with a recording: it says where "
            "the servos were, and not where the tool was (kilter measure match RECORDING FOLDER --calibration JSON "
            "--norm-mode MODE).",
        )
    pictures = [name for name in names if name.lower().endswith(PICTURES)]
    if pictures and len(pictures) > len(names) / 2:
        return fault(
            path,
            f"is a ZIP archive of {len(pictures)} pictures",
            "Unpack it: kilter measure see finds the board in them (kilter measure see FOLDER --board BOARD.json "
            "--joints JOINTS.csv).",
        )
    more = ", ..." if len(names) > MOST_NAMED else ""
    holds = f" ({', '.join(names[:MOST_NAMED])}{more})" if names else ", and empty"
    return fault(
        path,
        f"is a ZIP archive or a spreadsheet{holds}",
        "Unpack it, and give a file of it; a spreadsheet is read as .xlsx.",
    )
