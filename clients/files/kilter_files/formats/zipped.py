"""What a ZIP archive holds, by the names in it: nothing is unpacked, and whoever gave it is told what to do with its parts."""

from __future__ import annotations

from pathlib import Path

from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.workbook_formulas import member_names

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
