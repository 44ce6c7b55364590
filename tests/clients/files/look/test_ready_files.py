"""Files of contract columns in which something else than a point was measured are ready, as `kilter upload` takes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.look.inspection import inspect

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
