"""`kilterd doctor`: one line for each check, with the remedy where something is wrong."""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from kilter_service.ground.settings import Settings
from kilter_service.run.doctor import commands
from tests.service.conftest import ready
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def prepared(tmp_path: Path, migrated: Path) -> Settings:
    found = Settings(data=tmp_path / "data", database_url=None, port=0, zenoh_listen="tcp/127.0.0.1:0", token=None)
    found.data.mkdir(mode=0o700)
    ready(found, migrated)
    (found.data / "kilter.sqlite").chmod(0o600)
    return found


def doctor(settings: Settings, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **settings.environment()}
    done = forked_command("doctor", *arguments, environment=environment, folder=REPOSITORY)
    assert done.stderr == ""
    return done


def wrong(settings: Settings) -> dict[str, str]:
    return {check.name: check.detail for check in commands.run(settings) if not check.ok and check.name != "kernels"}


def test_it_prints_a_line_for_each_check_and_json(prepared: Settings) -> None:
    shown = doctor(prepared)
    assert [line[:5] for line in shown.stdout.splitlines()][:9] == ["ok   "] * 9, shown.stdout
    assert len(shown.stdout.splitlines()) == len(commands.CHECKS)
    other = json.loads(doctor(prepared, "--json").stdout)
    assert [check["name"] for check in other["checks"]] == list(commands.CHECKS)
    assert other["ok"] is all(check["ok"] for check in other["checks"]) is (shown.returncode == 0)


def test_open_files_a_missing_schema_and_a_newer_one(prepared: Settings) -> None:
    database = prepared.data / "kilter.sqlite"
    database.chmod(0o644)
    assert f"run `chmod go= {database}`" in commands.permissions(prepared)[1]
    database.chmod(0o600)
    for found, said in (("0001", "run `kilterd migrate`"), ("9999", "of a newer Kilter")):
        with closing(sqlite3.connect(database)) as file:
            file.execute("UPDATE alembic_version SET version_num = ?", (found,))
            file.commit()
        assert said in wrong(prepared)["schema"]


def test_a_clock_that_was_set_back(prepared: Settings) -> None:
    with closing(sqlite3.connect(prepared.data / "kilter.sqlite")) as file:
        file.execute("INSERT INTO robots (name, document, created_at) VALUES ('a', '{}', '2199-01-01 00:00:00.000000')")
        file.commit()
    found = wrong(prepared)["clock"]
    assert "something was stored at 2199-01-01" in found
    assert "set the clock" in found


def test_taken_ports_and_a_disk_that_is_nearly_full(prepared: Settings) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        taken = prepared.model_copy(update={"port": port, "zenoh_listen": f"tcp/127.0.0.1:{port}"})
        found = wrong(taken)
    assert "set KILTER_PORT to another" in found["port"]
    assert "set KILTER_ZENOH_LISTEN to another" in found["zenoh port"]
    huge = prepared.model_copy(update={"max_upload_mb": 1 << 40})
    assert "MB should be" in wrong(huge)["disk"]


def test_a_database_that_is_away_and_configurations(prepared: Settings, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
    away = prepared.model_copy(update={"database_url": f"postgresql://kilter@127.0.0.1:{port}/kilter"})
    found = wrong(away)
    assert found["database"].startswith("The database cannot be reached (")
    assert set(found) == {"database", "schema", "hashes", "clock"}
    bad = tmp_path / "zenoh.json5"
    bad.write_text("{ this is not")
    assert "is not a zenoh configuration" in wrong(prepared.model_copy(update={"zenoh_config": bad}))["zenoh config"]
    gone = prepared.model_copy(update={"zenoh_config": tmp_path / "gone"})
    assert "does not exist: correct KILTER_ZENOH_CONFIG" in wrong(gone)["zenoh config"]


def test_kernels_are_compiled_by_a_command_that_touches_nothing_else(tmp_path: Path) -> None:
    environment = os.environ | {"KILTER_DATA": str(tmp_path / "data")}
    done = subprocess.run(
        [sys.executable, "-m", "kilter_service", "compile"],
        cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "Kernels are compiled" in done.stdout
    assert not (tmp_path / "data").exists()
    assert commands.kernels(Settings(data=tmp_path / "data")) == (True, "compiled")


def test_kernels_of_another_release_do_not_count(tmp_path: Path) -> None:
    code = (
        "from kilter_core.arm.kernels import compiled; compiled._sources = lambda: b'other'\n"
        "from kilter_service.run.doctor import commands; print(commands.kernels(None))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=120, check=True
    )
    assert "not compiled yet" in done.stdout
    assert "`kilterd compile` compiles them before" in done.stdout
