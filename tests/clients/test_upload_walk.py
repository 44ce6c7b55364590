"""How many functions a plain `kilter upload FILE` passes through before its rows are on their way."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType
from typing import Any

from kilter_client.cli import run
from kilter_client.cli.files import upload
from tests.clients.conftest import WriteCampaign

# Functions of client and readers of files, each counted once, constructors and their like not; only ever fewer.
MOST = 48
OURS = ("/kilter_client/", "/kilter_files/")


def test_a_plain_upload_walks_straight(server: Path, robot: str, write_campaign: WriteCampaign) -> None:
    assert run(["upload", robot, str(write_campaign(name="earlier.csv", seed=2))]) == 0
    file, passed = write_campaign(), set[str]()
    walking = False

    def watch(frame: FrameType, event: str, _: Any) -> None:
        nonlocal walking
        code = frame.f_code
        if event != "call":
            return
        if code is upload.upload.__code__:
            walking = True
        elif code.co_name == "request" and str(frame.f_locals.get("url", "")).endswith("/observations"):
            walking = False  # httpx sends the rows
        if walking and not code.co_name.startswith(("<", "__")) and any(folder in code.co_filename for folder in OURS):
            passed.add(f"{code.co_filename}:{code.co_firstlineno} {code.co_name}")

    sys.setprofile(watch)
    try:
        assert run(["upload", robot, str(file)]) == 0
    finally:
        sys.setprofile(None)
    assert not walking
    assert 0 < len(passed) <= MOST, "\n".join(sorted(passed))
