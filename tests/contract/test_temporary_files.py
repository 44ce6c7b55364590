"""Where tests put their temporary files: in memory where there is room, and where TMPDIR says otherwise."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from tests import temporary_files
from tests.temporary_files import put_in_memory, serves


def test_a_folder_needs_room_and_runs_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = shutil.disk_usage(tmp_path).free
    assert serves(tmp_path, free // 2)
    assert not serves(tmp_path, 2 * free)
    assert not serves(tmp_path / "missing", 0)
    flags = os.statvfs(tmp_path)
    monkeypatch.setattr(os, "statvfs", lambda _: type("Flags", (), {"f_flag": flags.f_flag | os.ST_NOEXEC}))
    assert not serves(tmp_path, 0)  # the tests of the corrector in C run what they compile


def test_where_the_user_says_otherwise_they_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setenv("TMPDIR", "where the user wants them")
    put_in_memory(tmp_path)
    assert os.environ["TMPDIR"] == "where the user wants them"
    monkeypatch.delenv("TMPDIR")
    monkeypatch.setattr(temporary_files, "serves", lambda _: False)
    put_in_memory(tmp_path)
    assert "TMPDIR" not in os.environ
    monkeypatch.setattr(temporary_files, "serves", lambda _: True)
    put_in_memory(tmp_path)
    assert tempfile.gettempdir() == str(tmp_path)
