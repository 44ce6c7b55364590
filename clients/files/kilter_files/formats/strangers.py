"""Files that hold no measurements as they are, told by their first bytes: what they are, and where they belong."""

from __future__ import annotations

import re
from collections.abc import Mapping

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
