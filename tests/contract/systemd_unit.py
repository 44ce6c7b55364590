"""Runs a unit of deploy/systemd as it is printed, as systemd would, with its places in a folder of the test."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SYSTEMD = Path(__file__).resolve().parents[2] / "deploy" / "systemd"
LONGEST_STOP_S = "90"  # where a unit says nothing
CLEAN = {0, -signal.SIGTERM}  # of a service that was asked to stop


def settings_of(*files: Path) -> dict[str, list[str]]:
    """Every line of the section [Service] by its name; of a name that is there twice both count."""
    found: dict[str, list[str]] = {}
    for file in files:
        section = ""
        for line in file.read_text(encoding="utf-8").splitlines():
            if line.startswith("["):
                section = line
            elif section == "[Service]" and line and not line.startswith("#"):
                name, _, value = line.partition("=")
                found.setdefault(name, []).append(value)
    return found


class Unit:
    """A unit, with drop-ins if need be, whose folders of the system are in ``folder``."""

    def __init__(self, folder: Path, name: str, *drop_ins: str, instance: str = "") -> None:
        self.folder, self._instance = folder, instance
        self._service = settings_of(SYSTEMD / f"{name}.service", *(SYSTEMD / one for one in drop_ins))
        self._credentials = folder / "run" / f"{name}{instance}"
        self.log = folder / f"{name}{instance}.log"
        for state in self._each("StateDirectory"):
            (folder / "var" / state).mkdir(parents=True, exist_ok=True, mode=int(self._one("StateDirectoryMode"), 8))
        self._credentials.mkdir(parents=True, mode=0o700)
        for line in self._service.get("LoadCredential", ()):
            credential, _, source = line.partition(":")
            shown = self._credentials / credential
            shown.write_bytes(Path(self._here(source)).read_bytes())
            shown.chmod(0o440)  # as systemd shows it where it gives the account an entry of an access list

    def _one(self, name: str, otherwise: str = "") -> str:
        return self._service.get(name, [otherwise])[-1]

    def _each(self, name: str) -> list[str]:
        return [self._here(word) for line in self._service.get(name, ()) for word in line.split()]

    def _here(self, text: str) -> str:
        for printed, here in (
            ("/var/lib/", f"{self.folder}/var/"),
            ("/etc/kilter/", f"{self.folder}/etc/"),
            ("${CREDENTIALS_DIRECTORY}", str(self._credentials)),
            ("%d", str(self._credentials)),
            ("%i", self._instance),
            ("/opt/kilter/bin/kilterd", f"{sys.executable} -m kilter_service"),
        ):
            text = text.replace(printed, here)
        return text

    @property
    def environment(self) -> dict[str, str]:
        """What the unit's processes have in their environment; what a file says comes last."""
        found = {"PATH": os.environ["PATH"], "HOME": str(self.folder), "CREDENTIALS_DIRECTORY": str(self._credentials)}
        lines = self._each("Environment")
        for file in self._each("EnvironmentFile"):
            there = Path(file.removeprefix("-"))
            if there.exists() or not file.startswith("-"):
                lines += there.read_text(encoding="utf-8").splitlines()
        return found | dict(line.split("=", 1) for line in lines)

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        """Run a command line of the unit to its end."""
        return subprocess.run(
            shlex.split(self._here(command)), env=self.environment, umask=int(self._one("UMask"), 8), capture_output=True,
            text=True, timeout=120, check=False,
        )  # fmt: skip

    def once(self) -> subprocess.CompletedProcess[str]:
        """Run a unit of the type oneshot."""
        assert self._one("Type") == "oneshot"
        return self.run(self._one("ExecStart"))

    @contextmanager
    def started(self) -> Iterator[subprocess.Popen[bytes]]:
        """Start it, and stop it as `systemctl stop` does: in the time that it states, with success."""
        for before in self._service.get("ExecStartPre", ()):
            done = self.run(before)
            assert done.returncode == 0, done.stderr
        command = shlex.split(self._here(self._one("ExecStart")))
        with (
            self.log.open("ab") as log,
            subprocess.Popen(
                command, env=self.environment, umask=int(self._one("UMask"), 8), stdout=subprocess.PIPE, stderr=log
            ) as process,
        ):
            try:
                yield process
                process.terminate()
                assert process.wait(int(self._one("TimeoutStopSec", LONGEST_STOP_S))) in CLEAN, self.log.read_text()
            finally:
                process.kill()
