"""The compose file and the systemd units call commands and set variables that exist."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from kilter_service.program import COMMANDS
from kilter_service.settings import Settings

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
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


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_units_call_commands_and_start_again(unit: Path) -> None:
    parsed = configparser.ConfigParser(interpolation=None, strict=False)
    parsed.optionxform = str  # type: ignore[assignment, method-assign]
    parsed.read(unit, encoding="utf-8")
    service = parsed["Service"]
    for key in ("ExecStart", "ExecStartPre"):
        if key in service:
            program, command = service[key].split()
            assert (program, command in COMMANDS) == ("/opt/kilter/bin/kilterd", True)
    assert service["Restart"] == "always"
    assert service["StateDirectory"] in service["Environment"]
    named = set(re.findall(r"KILTER_\w+", service["Environment"]))
    assert named <= VARIABLES


def test_a_stream_outlives_the_corrector_that_systemd_starts_again() -> None:
    # By default systemd ends what is left of a service that was killed, and the stream process with it.
    assert "\nKillMode=process\n" in (DEPLOY / "systemd" / "kilter-corrector.service").read_text(encoding="utf-8")


def test_units_are_sound_to_systemd() -> None:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd is not installed")
    done = subprocess.run(
        [program, "verify", *map(str, UNITS)], capture_output=True, text=True, timeout=60, check=False
    )
    said = [line for line in done.stderr.splitlines() if "/opt/kilter" not in line and "kilter" in line]
    assert not said
