"""The compose file and the systemd units call commands and set variables that exist."""

from __future__ import annotations

import configparser
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
import yaml

from kilter_service.program import COMMANDS, parser
from kilter_service.settings import Settings

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
TIMERS = sorted((DEPLOY / "systemd").glob("*.timer"))
VARIABLES = {f"KILTER_{name.upper()}" for name in Settings.model_fields}


def test_compose_runs_every_part_on_one_database() -> None:
    text = (DEPLOY / "compose.yaml").read_text(encoding="utf-8")
    services = yaml.safe_load(text)["services"]
    called = {name: service["command"] for name, service in services.items() if "command" in service}
    assert {name: command[0] for name, command in called.items()} == dict.fromkeys(called, "kilterd")
    assert {command[1] for command in called.values()} == {"migrate", "api", "worker", "corrector"} <= set(COMMANDS)
    for name in called:
        environment = services[name]["environment"]
        assert set(environment) <= VARIABLES
        assert environment["KILTER_DATABASE_URL"].endswith("@postgres/kilter")
        if name != "migrate":
            assert services[name]["read_only"]
            assert services[name]["depends_on"] == {"migrate": {"condition": "service_completed_successfully"}}
    assert not re.search(r"PASSWORD: \w", text), "no password is written down"


def section_of(unit: Path, name: str = "Service") -> configparser.SectionProxy:
    parsed = configparser.ConfigParser(interpolation=None, strict=False)
    parsed.optionxform = str  # type: ignore[assignment, method-assign]
    parsed.read(unit, encoding="utf-8")
    return parsed[name]


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_units_call_commands_and_start_again(unit: Path) -> None:
    service = section_of(unit)
    for key in ("ExecStart", "ExecStartPre"):
        if key in service and not (key == "ExecStartPre" and service[key].startswith("/bin/cp ")):
            program, *arguments = service[key].split()
            assert program == "/opt/kilter/bin/kilterd"
            assert parser().parse_args(arguments).command in COMMANDS
    assert service.get("Type") == "oneshot" or service["Restart"] == "always"
    for folder in service["StateDirectory"].split():
        assert f"=/var/lib/{folder}" in service["Environment"]
    named = set(re.findall(r"KILTER_\w+", service["Environment"]))
    assert named <= VARIABLES


def test_units_that_share_a_folder_have_one_account() -> None:
    # systemd gives a folder of state, and all that is in it, to the account of the unit that starts.
    accounts: dict[str, set[str]] = {}
    for unit in UNITS:
        service = section_of(unit)
        for folder in service["StateDirectory"].split():
            accounts.setdefault(folder, set()).add(service.get("User", unit.stem.rstrip("@")))
    assert {folder: len(names) for folder, names in accounts.items()} == dict.fromkeys(accounts, 1)


@pytest.mark.parametrize("unit", ["kilter-corrector.service", "kilter.service"])
def test_a_stream_outlives_the_corrector_that_systemd_starts_again(unit: str) -> None:
    # By default systemd ends what is left of a service that was killed, and the stream process with it.
    assert "\nKillMode=process\n" in (DEPLOY / "systemd" / unit).read_text(encoding="utf-8")


def as_systemd(folder: Path, text: str) -> list[str]:
    """Words of a line of the unit, its places in a folder of the test and its program this checkout's."""
    places = {
        "/var/lib/": f"{folder}/var/",
        "${CREDENTIALS_DIRECTORY}": f"{folder}/credentials",
        "/opt/kilter/bin/kilterd": f"{sys.executable} -m kilter_service",
    }
    for stated, here in places.items():
        text = text.replace(stated, here)
    return text.split()


def test_the_unit_of_the_whole_server_runs_as_printed(tmp_path: Path) -> None:
    service = section_of(DEPLOY / "systemd" / "kilter.service")
    name, _, source = service["LoadCredential"].partition(":")
    etc, credentials, state = (tmp_path / part for part in ("etc", "credentials", "var/kilter"))
    for folder in (etc, credentials, state):
        folder.mkdir(parents=True, mode=0o700)
    # As the how-to makes it; HOME is another place, so that nothing of the account's own is used.
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path)}
    make = [sys.executable, "-m", "kilter_service", "stream-keys", "--data", str(etc)]
    subprocess.run(make, env=environment, check=True, capture_output=True, timeout=60)
    secret = etc / Path(source).name
    (credentials / name).write_bytes(secret.read_bytes())
    (credentials / name).chmod(0o440)  # as systemd shows it where it gives the account an entry of an access list
    environment |= dict(word.split("=", 1) for word in as_systemd(tmp_path, service["Environment"]))
    del environment["NUMBA_CACHE_DIR"]  # the kernels of this checkout are compiled
    environment |= {"KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}  # what /etc/kilter/kilter.env may say
    umask = int(service["UMask"], 8)
    for _ in range(2):  # the second start finds what the first has made
        before = as_systemd(tmp_path, service["ExecStartPre"])
        subprocess.run(before, env=environment, check=True, umask=umask, timeout=30)
    command = as_systemd(tmp_path, service["ExecStart"])
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, umask=umask) as server:
        try:
            assert server.stdout is not None
            document = json.loads(server.stdout.readline())
            assert (document["data"], "missing" in document) == (str(state), False)
            assert httpx.get(f"{document['url']}/v1/health/ready", timeout=30, trust_env=False).status_code == 200
            assert (state / name).read_bytes() == secret.read_bytes()
        finally:
            server.terminate()
            assert server.wait(int(service["TimeoutStopSec"])) == 0


def test_the_timer_s_backup_runs_as_printed(tmp_path: Path) -> None:
    service = section_of(DEPLOY / "systemd" / "kilter-backup.service")
    for folder in service["StateDirectory"].split():
        (tmp_path / "var" / folder).mkdir(parents=True, mode=int(service["StateDirectoryMode"], 8))
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path)}
    environment |= dict(word.split("=", 1) for word in as_systemd(tmp_path, service["Environment"]))
    migrate = [sys.executable, "-m", "kilter_service", "migrate"]
    subprocess.run(migrate, env=environment, check=True, capture_output=True, timeout=60)
    command = as_systemd(tmp_path, service["ExecStart"])
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "1 backups are kept" in done.stdout
    assert [timer.stem for timer in TIMERS] == ["kilter-backup"]
    assert section_of(TIMERS[0], "Timer")["Persistent"] == "yes"  # also where the machine was off at night


def test_units_are_sound_to_systemd() -> None:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd is not installed")
    done = subprocess.run(
        [program, "verify", *map(str, UNITS + TIMERS)], capture_output=True, text=True, timeout=60, check=False
    )
    said = [line for line in done.stderr.splitlines() if "/opt/kilter" not in line and "kilter" in line]
    assert not said
