"""All readers, and what opens a file by its own: as a table for a column map, or as a recording of markers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_files.formats.reader import MAP, USES, ZIP, Document, Head, Hints, Reader, RecordingReader, of_zip
from kilter_files.ground.errors import FileError, fault
from kilter_files.tables.source import Layout, Source

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording


def endings() -> Mapping[str, str]:
    """Return the format of every known ending of a table."""
    return {ending: name for name, reader in readers_for(MAP).items() for ending in reader.endings}


def open_source(path: Path, form: str | None, layout: Layout) -> Source:
    """Read ``path`` in ``form`` (the name of a reader; None: by the file's ending).

    Raises:
        FileError: an ending that says nothing, or a file its reader refuses.

    """
    form = form or _by_content(path) or endings().get(path.suffix.lower())
    if form is None:
        raise FileError(
            f"{path}: the ending {path.suffix!r} names no known format. "
            f"Set 'format' under [file] to one of {', '.join(readers_for(MAP))}.",
            file=str(path),
        )
    found: Source = readers_for(MAP)[form].read(path, Hints(layout=layout))
    return found


def _by_content(path: Path) -> str | None:
    """KUKA's data lists end in .dat, and programs are sent as .txt: what they hold tells them from tables."""
    return "program" if path.suffix.lower() in (".dat", ".txt") and has_format(path, "program") else None


def open_recording(
    path: Path, rate_hz: float | None = None, allow_cut: bool = False, unit: str | None = None
) -> Recording:
    """Read a recording of markers or tools: C3D, NDI floating point, or text; ``unit`` overrides what the file states.

    Raises:
        FileError: the file of another device, or a damaged one.

    """
    reader = binary_reader(Head(path)) or all_readers()["text"]
    if not isinstance(reader, RecordingReader):
        raise fault(path, f"is {reader.is_a}, not a recording of markers", reader.instead)
    return reader.read(path, Hints(rate_hz, allow_cut, unit=unit))


# modules of `kilter_files.formats.readers`: what first bytes show before what only columns show
READERS = (
    "bag",
    "lerobot",
    "lerobot_calibration",
    "tdms",
    "parquet",
    "mat",
    "workbook",
    "recordings.c3d",
    "recordings.n3d",
    "program",
    "json_records",
    "json_columns",
    "yaml_records",
    "contract",
    "ballbar",
    "inclinometer",
    "ipa_lasertracker",
    "recordings.marker_text",
    "text_table",
    "tracker_text",
)


@cache
def all_readers() -> Mapping[str, Reader[Any]]:
    """Return the readers by name, in the order in which they are asked."""
    found = [import_module(f"kilter_files.formats.readers.{module}").READER for module in READERS]
    return {reader.name: reader for reader in found}


def readers_for(use: str) -> Mapping[str, Reader[Any]]:
    """Return the readers whose files a command takes, by name."""
    return {name: reader for name, reader in sorted(all_readers().items()) if reader.use == use}


def find_reader(head: Head) -> Reader[Any]:
    """Return whose file it is.

    Raises:
        FileError: an empty file, or one of a kind that holds no measurements Kilter reads.

    """
    texts = (reader for reader in all_readers().values() if not reader.is_a and reader.recognises(head))
    return binary_reader(head) or next(
        texts
    )  # the last one takes whatever text there is, or says what is wrong with it


def binary_reader(head: Head) -> Reader[Any] | None:
    """Return whose file it is by its first bytes, None of a text.

    Raises:
        FileError: an empty file, or one of a kind that holds no measurements Kilter reads.

    """
    if not head.start and not head.path.is_dir():
        raise fault(head.path, "is empty", "Export it again.")
    refuse_stranger(head)
    return next((reader for reader in all_readers().values() if reader.is_a and reader.recognises(head)), None)


def refuse_stranger(head: Head) -> None:
    """Refuse a file that holds no measurements as it is; a workbook is a ZIP archive too.

    Raises:
        FileError: it is one; the sentence says where it belongs.

    """
    if head.start.startswith(ZIP):
        if not all_readers()["xlsx"].recognises(head):
            raise of_zip(head.path)
        return
    found = stranger(head.start)
    if found is not None:
        raise fault(head.path, f"is {found[0]}", found[1])


def has_format(path: Path, name: str) -> bool:
    """Tell whether a file is of the format with this name."""
    return all_readers()[name].recognises(Head(path))


def describe(path: Path, hints: Hints) -> Document:
    """Describe a file by its own reader.

    Raises:
        FileError: the file cannot be read at all, with place and remedy.

    """
    head = Head(path, hints)
    reader = find_reader(head)
    known: Document = {"kind": reader.name, "ready": False, "problems": [], "warnings": [], "notes": []}
    return known | reader.describe(head)


def list_formats() -> Iterator[tuple[str, str, tuple[str, ...], str]]:
    """Every format that is read: the command that takes it, its name, endings and title."""
    for use in USES:
        for reader in readers_for(use).values():
            for name, title in reader.names_and_titles():
                yield use, name, reader.endings, title


FIND = "Corners of a board in it are found with kilter measure see, which takes the joints too; upload what comes out"
EXPORT = "Export the numbers."
PICTURE = f"{FIND}. A scanned pencil sheet is read with kilter measure sheet-read; of a screenshot export the numbers."
VIDEO = f"{FIND}."
BY_BYTES: Mapping[bytes, tuple[str, str]] = {
    b"\x89HDF": ("an HDF5 file (MATLAB 7.3)", "Save it in MATLAB with '-v7'."),
    b"\x1f\x8b": ("compressed with gzip", "Unpack it first."),
    b"%PDF": ("a PDF", f"{EXPORT} A scanned pencil sheet is read with kilter measure sheet-read."),
    b"\x1aE\xdf\xa3": ("a video", VIDEO),
}
PICTURES = re.compile(
    rb"\x89PNG|\xff\xd8\xff|BM.{4}\0{4}|II\*\0|MM\0\*|RIFF.{4}WEBP|P[2-6]\s+\d+\s+\d+\s", re.DOTALL
)  # PNG, JPEG, BMP, TIFF, WebP, PGM and PPM
VIDEOS = re.compile(rb"RIFF.{4}AVI |.{4}ftyp", re.DOTALL)
DOCUMENTS: tuple[tuple[re.Pattern[bytes], str, str], ...] = (
    (
        re.compile(rb'\s*\{(?=.*"cameras"\s*:)', re.DOTALL),
        "the description of cameras and boards that kilter measure see writes beside its views",
        "Give it with them: kilter upload ROBOT views.csv --cameras THIS; on the page drop the views first, and it after them.",
    ),
    (
        re.compile(rb'\s*\{(?=.*"kind"\s*:\s*"(?:charuco|apriltag)")', re.DOTALL),
        "the description of a printed board",
        "Give it to kilter measure see (--board) with the pictures, and upload what comes out.",
    ),
    (
        re.compile(
            rb"(?=.*(?:camera_matrix|camera_model)\b)(?=.*\b(?:image_width|distortion_coefficients|distortion_model)\b)",
            re.DOTALL,
        ),
        "a description of the intrinsics of a camera",
        "Give it to kilter measure see (--camera) with the pictures, and upload what comes out.",
    ),
)


def stranger(start: bytes) -> tuple[str, str] | None:
    """Return what a file that begins so is, and where it belongs; None of one that may hold measurements."""
    for magic, said in BY_BYTES.items():
        if start.startswith(magic):
            return said
    if PICTURES.match(start):
        return "a picture", PICTURE
    if VIDEOS.match(start):
        return "a video", VIDEO
    text = start.removeprefix(b"\xef\xbb\xbf")
    return next(((what, remedy) for shape, what, remedy in DOCUMENTS if shape.match(text)), None)
