"""What a file that cannot be read raises, and what every exception of Kilter's client has in common.

Suggestions for misspelt names, and numbers of sessions that have names.
"""

from __future__ import annotations

import difflib
import unicodedata
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

CUT = "Copy or export it again. If it was recorded like that, allow_cut (--allow-cut) uses the complete frames."


class KilterError(Exception):
    """Something that went wrong, with a stable ``code``, a sentence (``detail``) and a ``context``."""

    default_code: ClassVar[str] = "kilter_error"
    default_title: ClassVar[str] = "Kilter error"

    def __init__(self, detail: str, *, code: str | None = None, status: int | None = None, **context: Any) -> None:
        super().__init__(detail)
        self.detail = detail
        self.code = code or self.default_code
        self.title = self.default_title
        self.status = status
        self.context: dict[str, Any] = context
        self.request_id: str | None = None

    def to_document(self) -> dict[str, Any]:
        """Return the error as a problem document (RFC 9457), as the server writes them."""
        return {
            "type": f"urn:kilter:problem:{self.code}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            "code": self.code,
            "context": self.context,
            "request_id": self.request_id,
        }


class FileError(KilterError):
    """A file that cannot be read as measurements; names file, line, column and remedy."""

    default_code = "file_invalid"
    default_title = "File not understood"


class MissingPackageError(KilterError):
    """A file format that needs a package which is not installed."""

    default_code = "package_missing"
    default_title = "Package missing"


class UsageError(KilterError):
    """Options of the command line that do not go together."""

    default_code = "usage"
    default_title = "Wrong usage"


def fault(path: Path, what: str, remedy: str, **place: Any) -> FileError:
    """Build the error of a file; ``place`` is any of line, frame, column, byte."""
    named = [f"{key} {value!r}" if key == "column" else f"{key} {value}" for key, value in place.items()]
    return FileError(f"{', '.join([str(path), *named])}: {what}. {remedy}", file=str(path), **place)


def read_head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file.

    Raises:
        FileError: it cannot be read.

    """
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}.", file=str(path)) from error


NAMED_SESSIONS = 1_000_000  # numbers from here on stand for names; smaller ones count within a campaign


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the nearest known name, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def number_of_session(name: str) -> int:
    """Return the number that stands for the name of a session."""
    text = unicodedata.normalize("NFC", name.strip())
    return NAMED_SESSIONS + zlib.crc32(text.encode()) % (9 * NAMED_SESSIONS)
