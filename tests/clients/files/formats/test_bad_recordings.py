"""Files that are not what they should be: refused with file, place and remedy."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from kilter_client import FileError
from kilter_files.formats.registry import open_recording
from tests.clients.files.formats.test_recordings import c3d_bytes
from tests.clients.files.simulated import write_csv, write_n3d

POINTS = np.random.default_rng(3).uniform(-500, 500, (40, 3, 3))


def refused(path: Path, words: str, **place: object) -> None:
    with pytest.raises(FileError, match=words) as caught:
        for _ in open_recording(path).blocks():
            pass
    assert caught.value.context["file"] == str(path)
    assert {key: caught.value.context.get(key) for key in place} == place


@pytest.mark.parametrize("kind", ["c3d", "n3d"])
def test_cut_off_glued_and_of_wrong_magic(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "n3d":
        write_n3d(path, POINTS, 100.0)
    else:
        path.write_bytes(c3d_bytes(POINTS, 100.0, -1.0, "<", "mm"))
    whole = path.read_bytes()
    path.write_bytes(whole[:-700])
    refused(path, "is cut off: .* states 40 frames")
    assert open_recording(path, allow_cut=True).frames < 40
    path.write_bytes(whole + whole)
    refused(path, "two recordings are concatenated")
    path.write_bytes(b"\x07\x07" + whole[2:])
    refused(path, "is not an? ")
    path.write_bytes(whole[:100])
    refused(path, "is not an? |is cut off")


def test_a_header_that_claims_ten_gigabytes(tmp_path: Path) -> None:
    path = write_n3d(tmp_path / "a.n3d", POINTS, 100.0)
    content = path.read_bytes()
    path.write_bytes(struct.pack("<Bhhif", 32, 3, 3, 280_000_000, 100.0) + content[13:])
    refused(path, r"states 280000000 frames of 3 markers \(10080000256 bytes\), 40 are there", frame=41)
    path = tmp_path / "a.c3d"
    content = c3d_bytes(POINTS, 100.0, -1.0, "<", "mm")
    path.write_bytes(content[:2] + struct.pack("<H", 65535) + content[4:])
    refused(path, "is cut off: POINT:FRAMES states 40 frames")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04" + b"\0" * 600, "ZIP archive or a spreadsheet. Unpack it"),
        (b"\x1f\x8b" + b"\0" * 600, "compressed with gzip"),
        (b"TDSm" + b"\0" * 600, "TDMS file, not a recording of markers"),
        (b"MATLAB 5.0 MAT-file" + b"\0" * 600, "MATLAB file, not a recording"),
        (b"\x00\x01\x02" * 300, "binary file, not text"),
        (b"just some words\nand more of them\n", "no table of numbers"),
    ],
)
def test_the_file_of_another_device(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.dat"
    path.write_bytes(content)
    refused(path, words)


@pytest.mark.parametrize(
    ("change", "words", "line", "column"),
    [
        (lambda r: [*r[:20], r[20].rsplit(",", 1)[0], *r[21:]], "9 cells where the first row has 10", 21, None),
        (lambda r: [*r[:20], r[20].replace(r[20].split(",")[4], "oops"), *r[21:]], "'oops' is not a number", 21, "Marker_2 x"),
        (lambda r: [*r[:20], *r[4:6], *r[20:]], "a second header is here|states 40", None, None),
        (lambda r: [*r[:15], *(f"{row.split(',', 1)[0]},,{row.split(',', 1)[1].rsplit(',', 1)[0]}" for row in r[15:])],
         "x of Marker_1 is blank where its other coordinates are not", 16, "Marker_1 x"),
        (lambda r: [*r[:15], *("," + row.rsplit(",", 1)[0] for row in r[15:])], "frame counter is missing", 16, None),
        (lambda r: r[:30], "is cut off: it states 40 frames, 25 are there", None, None),
        (lambda r: [*r, *r[5:]], "has 80 frames where it states 40", 46, None),
        (lambda r: [*r[1:], *r[5:]], "the frame counter goes back. If two recordings are concatenated", 45, None),
    ],
)  # fmt: skip
def test_a_damaged_text(tmp_path: Path, change, words: str, line: int | None, column: str | None) -> None:
    path = write_csv(tmp_path / "a.csv", POINTS, 100.0)
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    place = {key: value for key, value in (("line", line), ("column", column)) if value is not None}
    refused(path, words, **place)


def test_a_quaternion_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{i},1,2,3,1,0,0,0" for i in range(1, 9))
    path.write_text(f"Frequency,60\nFrame,Tx,Ty,Tz,Q0,Qx,Qy,Qz\n{rows}\n9,1,2,3,12,0,0,0\n")
    refused(path, "quaternion of Marker_1 does not have length 1", line=11, column="Q0")


def test_no_rate(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Frame,a x,a y,a z\n1,1,2,3\n2,1,2,3\n")
    refused(path, "says neither rate nor time. Give the rate in Hz")
    assert open_recording(path, rate_hz=50.0).rate_hz == 50
