"""A picture as grey pixels; its header is read, and its size checked, before anything is unpacked.

An image file opened so that a damaged or cut one raises, whatever else this process has imported.

Pillow decodes what is there of a cut file once anybody sets ``ImageFile.LOAD_TRUNCATED_IMAGES``; WeasyPrint does when it is
imported.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.later import Image, need

Grey = NDArray[np.uint8]

MOST_PIXELS = 64_000_000
MOST_BYTES = 1 << 28
LEAST_SIDE = 32
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "PPM", "WEBP")
ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
DEEP = ("I;16", "I;16B", "I;16L", "I")
INSTALL = "'opencv-python-headless>=4.14.0.94' numpy pillow"


class RefusedError(Exception):
    """A picture that cannot be used; ``refusal`` says why."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.sentence())
        self.refusal = refusal


def read_grey(path: Path, size: tuple[int, int] | None = None) -> Grey:
    """Read a picture as the sensor saw it (height, width): what its metadata say of rotation is ignored.

    ``size`` is the camera's width and height, where it is known.

    Raises:
        RefusedError: another size, no picture, a damaged or cut one, more pixels than any camera has.
        MissingPackageError: Pillow is not installed.

    """
    try:
        with path.open("rb") as stream:
            return read_grey_stream(str(path), stream, path.stat().st_size, size)
    except OSError as error:
        raise RefusedError(Refusal(str(path), "picture_unreadable", f"cannot be read: {error.strerror}")) from error


def read_grey_stream(name: str, stream: BinaryIO, length: int, size: tuple[int, int] | None = None) -> Grey:
    """Read a picture of so many bytes, as :func:`read_grey` does."""
    need("Pictures need", "Pillow", "PIL.Image", install=INSTALL)
    try:
        if length > MOST_BYTES:
            raise RefusedError(Refusal(name, "picture_too_large", f"has {length >> 20} MB"))
        with whole_picture(stream, FORMATS) as image:
            check_size(name, image.size, size)
            return _grey(image)
    except RefusedError:
        raise
    except (Image.DecompressionBombError, MemoryError) as error:
        raise RefusedError(Refusal(name, "picture_too_large", "states more pixels than a camera has")) from error
    except Exception as error:  # Pillow's decoders let OSError, SyntaxError, struct.error, ValueError and more through
        what = f"is not a picture, or damaged or cut off: {str(error)[:120] or type(error).__name__}"
        raise RefusedError(Refusal(name, "picture_unreadable", what)) from error


def check_size(name: str, stated: tuple[int, int], size: tuple[int, int] | None) -> None:
    """Refuse a width and height that no camera has, or that is not this camera's.

    Raises:
        RefusedError: it is so.

    """
    width, height = stated
    if width * height > MOST_PIXELS:
        what = f"states {width} x {height} pixels, and at most {MOST_PIXELS // 1_000_000} million are read"
        raise RefusedError(Refusal(name, "picture_too_large", what))
    if size is not None and stated != size:
        what = f"has {width} x {height} pixels, and the camera {size[0]} x {size[1]}"
        raise RefusedError(Refusal(name, "picture_other_camera", what))
    if min(stated) < LEAST_SIDE:
        raise RefusedError(Refusal(name, "picture_unreadable", f"has {width} x {height} pixels, too few for a board"))


def _grey(image: Any) -> Grey:
    if image.mode in DEEP:
        deep = np.asarray(image)
        bits = max(8, int(deep.max(initial=0)).bit_length())  # 10 or 12 bits in 16 would be dark
        return np.asarray(deep.astype(np.int64) >> (bits - 8), dtype=np.uint8)
    return np.array(image if image.mode == "L" else image.convert("L"), dtype=np.uint8)


REMEDIES = {
    "picture_unreadable": "Save it again as PNG: it loses nothing.",
    "picture_too_large": "Give the camera's own pictures; none of a camera has so many pixels.",
    "picture_other_camera": "Leave it out, or run kilter measure see for that camera alone.",
    "picture_blurred": "Take it again when the arm rests, with a shorter exposure and more light.",
    "board_not_found": "Take it so that the board fills a quarter of the picture, lit evenly, without glare.",
    "dictionary_differs": 'Write the "dictionary" that was printed into the board\'s JSON with kilter measure board.',
    "markers_unknown": "Give the JSON of the board that was printed (kilter measure board --first-id).",
    "columns_rows_swapped": "Write the board's JSON anew with kilter measure board: --columns is the count from left to right.",
    "board_size_differs": "Count its squares from left to right (--columns) and down (--rows), and write its JSON anew.",
    "legacy_pattern": 'Set "legacy_pattern" in the board\'s JSON as the board was printed.',
    "print_mirrored": "Print the board without mirroring, or switch off the camera's mirror.",
    "board_twice": "Cover one of the boards, or print one with other numbers (kilter measure board --first-id).",
    "too_few_corners": "Show more of the board: 12 corners make a good view, 4 are the least.",
    "arm_moving": "Let the arm rest at every pose, longer than a few frames.",
    "detectors_differ": "Look at that corner: glare, a shadow, or ink that has run moves it. Take the picture again.",
    "joints_missing": "Add its row to the joint log, or leave the picture out.",
}


@dataclass(frozen=True)
class Refusal:
    """A view that is not taken: ``code``, where, and what was seen; ``corner`` is its number on the board."""

    picture: str
    code: str
    what: str
    corner: int | None = None
    board: str | None = None

    @property
    def remedy(self) -> str:
        """What to do."""
        return REMEDIES[self.code]

    def sentence(self) -> str:
        """Return the whole as people read it."""
        place = self.picture if self.corner is None else f"{self.picture}, corner {self.corner}"
        return f"{place}: {self.what}. {self.remedy}"

    def to_document(self) -> dict[str, Any]:
        """Return the refusal as the JSON file holds it."""
        document: dict[str, Any] = {
            "picture": self.picture,
            "code": self.code,
            "detail": self.what,
            "remedy": self.remedy,
        }
        if self.corner is not None:
            document |= {"corner": self.corner}
        return document if self.board is None else document | {"board": self.board}


_ONE_AT_A_TIME = Lock()  # Pillow's setting is of the process


@contextmanager
def whole_picture(source: Path | BinaryIO, formats: tuple[str, ...]) -> Iterator[Any]:
    """Open an image file for as long as it is decoded; what Pillow raises then is the caller's to word.

    Raises:
        MissingPackageError: Pillow is not installed.

    """
    decoders = need("Pictures need", "Pillow", "PIL.ImageFile")
    with _ONE_AT_A_TIME, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of doubtful metadata; the caller checks sizes
        before, decoders.LOAD_TRUNCATED_IMAGES = decoders.LOAD_TRUNCATED_IMAGES, False
        try:
            with Image.open(source, formats=formats) as image:
                yield image
        finally:
            decoders.LOAD_TRUNCATED_IMAGES = before
