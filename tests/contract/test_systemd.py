"""The units of deploy/systemd run as printed, except for their places: alone, and on several machines with PostgreSQL."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import sqlite3
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path

import httpx
import pytest

from kilter_service.ground.child_process import STRANGERS
from kilter_service.jobs.work.worker import ENDS_BEFORE
from kilter_service.stream.corrector.loop import REAL_TIME_PRIORITY
from tests.contract.systemd_unit import SYSTEMD, Unit, settings_of
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


SERVICES = sorted(path.stem for path in SYSTEMD.glob("*.service"))
SOCKETS = {"AF_UNIX", "AF_INET", "AF_INET6"}


@pytest.mark.parametrize("name", SERVICES)
def test_a_unit_has_no_devices_few_kinds_of_sockets_and_a_limit_of_memory(name: str) -> None:
    said = settings_of(SYSTEMD / f"{name}.service")
    assert (said["PrivateDevices"], len(said["MemoryMax"])) == (["yes"], 1)
    zenoh = set() if name == "kilter-backup" else {"AF_NETLINK"}
    assert {family for line in said["RestrictAddressFamilies"] for family in line.split()} == SOCKETS | zenoh
    shared = name in ("kilter", "kilter-api", "kilter-worker@")  # by processes of which one may end alone
    assert said.get("OOMPolicy", []) == (["continue"] if shared else [])
    streams = name in ("kilter", "kilter-corrector")
    assert said.get("LimitRTPRIO", []) == ([str(REAL_TIME_PRIORITY)] if streams else [])


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize("name", SERVICES)
def test_systemd_knows_every_line_of_a_unit(name: str, tmp_path: Path) -> None:
    unit = tmp_path / f"{name}.service"
    printed = (SYSTEMD / unit.name).read_text(encoding="utf-8")
    unit.write_text(printed.replace("/opt/kilter/bin/kilterd", "/bin/true").replace("=/etc/kilter", "=-/etc/kilter"))
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_what_reads_files_of_strangers_ends_first_where_memory_is_used_up() -> None:
    program = (
        "from kilter_service.ground.memory import set_out_of_memory_score; set_out_of_memory_score({}); "
        "print(open('/proc/self/oom_score_adj').read())"
    )
    scores = [
        int(subprocess.run([sys.executable, "-c", program.format(score)], capture_output=True, check=True).stdout)
        for score in (STRANGERS, ENDS_BEFORE)
    ]
    assert scores == sorted({STRANGERS, ENDS_BEFORE, 0}, reverse=True)[:2]


def parts(client: httpx.Client) -> dict[str, str]:
    checks = client.get("/v1/health").json()["checks"]
    return {name: checks[name]["detail"] for name in ("worker", "corrector")}
