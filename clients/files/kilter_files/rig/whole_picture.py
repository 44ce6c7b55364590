"""An image file opened so that a damaged or cut one raises, whatever else this process has imported.

Pillow decodes what is there of a cut file once anybody sets ``ImageFile.LOAD_TRUNCATED_IMAGES``; WeasyPrint does when it is
imported.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

from kilter_files.ground.later import Image, need

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
