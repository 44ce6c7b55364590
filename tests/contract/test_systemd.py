"""The units of deploy/systemd run as printed, except for their places: alone, and on several machines with PostgreSQL."""

from __future__ import annotations

import json
import os
import secrets
import sqlite3
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path

import httpx
import pytest

from tests.contract.systemd_unit import SYSTEMD, Unit
from tests.service.conftest import Katana, wait_for
from tests.service.postgresql import programs, running_postgresql

FREE_PORTS = "KILTER_PORT=0\nKILTER_ZENOH_LISTEN=tcp/127.0.0.1:0\n"
SECRET = "stream-keys.json"


def kilterd(home: Path, *arguments: str) -> None:
    """Run a command as the how-to says; nothing of the account's own is used."""
    command = [sys.executable, "-m", "kilter_service", *arguments]
    environment = {"PATH": os.environ["PATH"], "HOME": str(home)}
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=280)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> None:
    kilterd(tmp_path_factory.mktemp("home"), "compile")


@pytest.fixture
def system(tmp_path: Path, compiled: None) -> Path:
    """A folder with what the how-to makes in /etc/kilter; the kernels are compiled as it says."""
    etc = tmp_path / "etc"
    etc.mkdir(mode=0o700)
    kilterd(tmp_path, "stream-keys", "--data", str(etc))
    (etc / "kilter.env").write_text(FREE_PORTS)
    return tmp_path


def compiled_by_units(folder: Path) -> set[str]:
    """Kernels that a unit compiled for itself, though `kilterd compile` had compiled them for every process."""
    return {file.name.partition(".")[0] for file in (folder / "var").rglob("*.nbc")}


@pytest.mark.parametrize("starts", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_whole_server_and_its_backup_with_a_key_for_the_seals(starts: int, system: Path) -> None:
    (system / "etc" / "seal-key").write_text(secrets.token_urlsafe(48))
    unit, backup = (Unit(system, name, "seal-key.conf") for name in ("kilter", "kilter-backup"))
    state = system / "var" / "kilter"
    for _ in range(starts):  # a second start finds what the first has made
        with unit.started() as server:
            assert server.stdout is not None
            document = json.loads(server.stdout.readline())
            assert (document["data"], "missing" in document) == (str(state), False)
            ready = httpx.get(f"{document['url']}/v1/health/ready", timeout=30, trust_env=False)
            assert ready.status_code == 200, ready.text
            assert (state / SECRET).read_bytes() == (system / "etc" / SECRET).read_bytes()
    done = backup.once()
    assert (done.returncode, done.stderr) == (0, "")
    assert "1 backups are kept" in done.stdout
    with closing(sqlite3.connect(state / "kilter.sqlite")) as file:
        ((key,),) = file.execute("SELECT keyed_by FROM database_seal").fetchall()
    assert key
    assert compiled_by_units(system) == set()


@pytest.mark.skipif(programs() is None, reason="PostgreSQL is not installed")
def test_the_units_of_several_machines_work_together(system: Path) -> None:
    token = secrets.token_urlsafe(32)
    with running_postgresql() as url, ExitStack() as running:
        settings = f"{FREE_PORTS}KILTER_DATABASE_URL={url}\nKILTER_TOKEN={token}\n"
        (system / "etc" / "kilter.env").write_text(settings)
        units = {
            "kilter-api": Unit(system, "kilter-api"),
            "kilter-worker@": Unit(system, "kilter-worker@", instance="1"),
            "kilter-corrector": Unit(system, "kilter-corrector"),
        }
        api, *_ = [running.enter_context(unit.started()) for unit in units.values()]
        assert api.stdout is not None
        headers = {"Authorization": f"Bearer {token}"}
        address = json.loads(api.stdout.readline())["url"]
        client = running.enter_context(httpx.Client(base_url=address, headers=headers, timeout=60, trust_env=False))
        wait_for(lambda: parts(client) == {"worker": "1 alive", "corrector": "1 alive"})
        katana = Katana()
        job = {"kind": "identify", "robot": katana.name, "campaigns": [katana.campaign(client, 30)]}
        queued = client.post("/v1/jobs", json=job | {"options": {"level": 1}}).raise_for_status().json()["id"]
        wait_for(lambda: client.get(f"/v1/jobs/{queued}").json()["state"] == "succeeded")
        copies = [system / "var" / place / SECRET for place in ("kilter", "kilter-corrector")]
        assert {copy.read_bytes() for copy in copies} == {(system / "etc" / SECRET).read_bytes()}
        backup = Unit(system, "kilter-backup")
        assert "1 backups are kept" in backup.once().stdout
    assert compiled_by_units(system) <= {"neighbours"}  # in seconds, and kept by numba for each folder
    assert {f"{name}.service" for name in (*units, "kilter-backup", "kilter")} == {
        file.name for file in SYSTEMD.glob("*.service")
    }


def parts(client: httpx.Client) -> dict[str, str]:
    checks = client.get("/v1/health").json()["checks"]
    return {name: checks[name]["detail"] for name in ("worker", "corrector")}
