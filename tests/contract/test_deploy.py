"""The compose file and the systemd units call commands and set variables that exist."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from kilter_service.ground.settings import Settings
from kilter_service.run.program import COMMANDS, parser

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
    commands = re.findall(r"^Exec\w+=(/opt/\S+) (.*)$", unit.read_text(encoding="utf-8"), re.MULTILINE)
    assert commands
    for program, arguments in commands:
        assert program == "/opt/kilter/bin/kilterd"
        assert parser().parse_args(arguments.split()).command in COMMANDS
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


def test_the_timer_starts_the_backup_also_where_the_machine_was_off_at_night() -> None:
    assert [timer.stem for timer in TIMERS] == ["kilter-backup"]
    assert section_of(TIMERS[0], "Timer")["Persistent"] == "yes"


def test_units_are_sound_to_systemd() -> None:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd is not installed")
    done = subprocess.run(
        [program, "verify", *map(str, UNITS + TIMERS)], capture_output=True, text=True, timeout=60, check=False
    )
    said = [line for line in done.stderr.splitlines() if "/opt/kilter" not in line and "kilter" in line]
    assert not said
