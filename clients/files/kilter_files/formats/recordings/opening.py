"""Which reader a recording of markers has: by its first bytes, not by its name."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.joints.mcap_check import MCAP, SQLITE
from kilter_files.formats.recordings.c3d import read_c3d
from kilter_files.formats.recordings.c3d_parameters import SECTOR, is_c3d
from kilter_files.formats.recordings.kinds import RECORDINGS
from kilter_files.formats.recordings.marker_text import read_marker_text
from kilter_files.formats.recordings.ndi_n3d import is_n3d, read_n3d
from kilter_files.ground.faults import fault, head_of
from kilter_files.tables.recording import Recording, in_unit

PICTURE = "Export the numbers; a scanned pencil sheet is read with kilter sheet-read."
ZIP = b"PK\x03\x04"
OTHERS = {
    b"TDSm": ("a TDMS file", "See what it holds with kilter inspect."),
    SQLITE: ("a ROS 2 bag (SQLite)", "It is the joint log: kilter match RECORDING BAG."),
    MCAP: ("a ROS 2 bag (MCAP)", "It is the joint log: kilter match RECORDING BAG."),
    b"PAR1": ("a Parquet file", "Send contract columns with kilter upload, others with a column map."),
    b"MATLAB 5.0": ("a MATLAB file", "Send it with a column map (kilter upload --map)."),
    b"\x89HDF": ("an HDF5 file (MATLAB 7.3)", "Save it in MATLAB with '-v7'."),
    ZIP: ("a ZIP archive or a spreadsheet", "Unpack it; a spreadsheet is read as .xlsx or CSV."),
    b"\x1f\x8b": ("compressed with gzip", "Unpack it first."),
    b"%PDF": ("a PDF", PICTURE),
    b"\x89PNG": ("a picture", PICTURE),
    b"\xff\xd8\xff": ("a picture", PICTURE),
}


def kind_of(path: Path) -> str:
    """Return ``c3d``, ``n3d``, ``tdms``, ``mat``, ``parquet``, ``bag``, ``xlsx`` or ``text`` by a file's first bytes.

    Raises:
        FileError: an empty file, or one of a kind that holds no measurements Kilter reads.

    """
    head = head_of(path, SECTOR)
    if not head:
        raise fault(path, "is empty", "Export it again.")
    known = {b"TDSm": "tdms", b"PAR1": "parquet", b"MATLAB 5.0": "mat", SQLITE: "bag", MCAP: "bag"}
    for magic, (what, remedy) in OTHERS.items():
        if head.startswith(magic) and magic in known:
            return known[magic]
        if head.startswith(magic) and magic == ZIP and path.suffix.lower() in (".xlsx", ".xlsm"):
            return "xlsx"
        if head.startswith(magic):
            raise fault(path, f"is {what}", remedy)
    if is_c3d(head) or path.suffix.lower() in RECORDINGS["c3d"][1]:
        return "c3d"
    if (b"\0" in head and is_n3d(head)) or path.suffix.lower() in RECORDINGS["n3d"][1]:
        return "n3d"
    return "text"


def open_recording(
    path: Path, rate_hz: float | None = None, allow_cut: bool = False, unit: str | None = None
) -> Recording:
    """Read a recording of markers or tools: C3D, NDI floating point, or text; ``unit`` overrides what the file states.

    Raises:
        FileError: the file of another device, or a damaged one.

    """
    found = _opened(path, rate_hz, allow_cut)
    return found if unit is None else in_unit(found, unit)


def _opened(path: Path, rate_hz: float | None, allow_cut: bool) -> Recording:
    kind = kind_of(path)
    if kind in ("c3d", "n3d"):
        return read_c3d(path, allow_cut) if kind == "c3d" else read_n3d(path, allow_cut)
    if kind != "text":
        what, remedy = next(found for magic, found in OTHERS.items() if head_of(path, 16).startswith(magic))
        raise fault(path, f"is {what}, not a recording of markers", remedy)
    return read_marker_text(path, rate_hz, allow_cut)
