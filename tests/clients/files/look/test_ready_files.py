"""Files of contract columns in which something else than a point was measured are ready, as `kilter upload` takes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.registry import stranger
from kilter_files.ground.errors import FileError
from kilter_files.look.drafts import inspect

VIEWS = "q1_deg,q2_deg,u1_px,v1_px,u2_px,v2_px,camera,board\n1,2,10.5,20.5,,,left,sheet\n3,4,11.5,21.5,12.5,22.5,left,sheet\n"
TILTS = "q1_deg,q2_deg,tilt1x_deg,tilt2y_deg,session\n1,2,0.1,,1\n3,4,,0.2,1\n"
CONTACTS = "q1_deg,q2_deg,socket_id\n1,2,1\n3,4,1\n"
LOG = "q1_deg,q2_deg,t_s\n1,2,0.0\n3,4,0.5\n"


@pytest.mark.parametrize(("text", "ready"), [(VIEWS, True), (TILTS, True), (CONTACTS, True), (LOG, False)])
def test_inspect_says_what_upload_takes(tmp_path: Path, text: str, ready: bool) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(text)
    found = inspect(path)
    assert bool(found.get("ready")) is ready
    assert (found["kind"] == "contract-columns") is ready


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            b"\x89PNG\r\n\x1a\n" + b"\xff" * 99,
            "is a picture. Corners of a board in it are found with kilter measure see",
        ),
        (b"RIFF\x10\0\0\0WEBPVP8 " + b"\xff" * 99, "is a picture."),
        (b"P5\n640 480\n255\n" + b"\x80" * 99, "is a picture."),
        (b"RIFF\x10\0\0\0AVI LIST" + b"\xff" * 99, "is a video."),
        (
            b'{"kind": "charuco", "columns": 9}',
            "is the description of a printed board. Give it to kilter measure see (--board)",
        ),
        (b'{"rows": 1, "cameras": [], "boards": []}', "kilter upload ROBOT views.csv --cameras THIS"),
        (b"image_width: 9\ncamera_matrix:\n  rows: 3\n", "Give it to kilter measure see (--camera)"),
        (b"cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n", "Give it to kilter measure see (--camera)"),
    ],
)
def test_what_holds_no_measurements_is_told_where_it_belongs(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "given"
    path.write_bytes(content)
    with pytest.raises(FileError) as refused:
        inspect(path)
    assert said in refused.value.detail


@pytest.mark.parametrize(
    "text", [VIEWS, TILTS, LOG, "BMS_1,P2,P5\n1,2,3\n", "camera,q1_deg\nleft,1\n", '{"q1_deg": [1]}']
)
def test_tables_are_not_taken_for_something_else(text: str) -> None:
    assert stranger(text.encode()) is None
