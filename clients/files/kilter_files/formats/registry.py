"""The one list of readers, in the order in which they are asked whether a file is theirs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from kilter_files.formats.reader import USES, Document, Head, Hints, Reader
from kilter_files.formats.strangers import stranger
from kilter_files.formats.zipped import ZIP, of_zip
from kilter_files.ground.errors import fault

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
