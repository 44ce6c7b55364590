"""Commands of `kilterd` as forks of a process that has imported them: processes like any other, up to three seconds sooner."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import tempfile
from collections.abc import Mapping
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from typing import Any

# What a worker imports at its start and with its first jobs. None of it starts a thread, so that it may be forked.
IMPORTED = [
    "kilter_service.program",
    "kilter_service.serving",
    "kilter_service.jobs.worker",
    "kilter_core.identify",
    "kilter_core.gap",
    "kilter_core.evaluate",
]
DEADLINE_S = 240.0


def forked_worker(environment: dict[str, str], folder: Path) -> ForkServerProcess:
    """Return a worker that is started; the process it is a fork of lives as long as this one."""
    return _started(environment, folder, ["worker"])


def forked_command(
    *arguments: str, environment: Mapping[str, str], folder: Path, umask: int = -1, deadline_s: float = DEADLINE_S
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, as `subprocess.run` would."""
    with tempfile.TemporaryDirectory(prefix="kilter-said-") as said:
        out, err = Path(said) / "out", Path(said) / "err"
        process = _started(dict(environment), folder, list(arguments), out=str(out), err=str(err), umask=umask)
        process.join(deadline_s)
        if process.exitcode is None:
            process.kill()
            process.join()
            raise AssertionError(f"kilterd {' '.join(arguments)} does not end: {err.read_text()}")
        return subprocess.CompletedProcess(arguments, process.exitcode, out.read_text(), err.read_text())


def _started(environment: dict[str, str], folder: Path, arguments: list[str], **how: Any) -> ForkServerProcess:
    context: ForkServerContext = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    process = context.Process(target=_run, args=(environment, str(folder), arguments), kwargs=how)
    process.start()
    return process


def _run(
    environment: dict[str, str], folder: str, arguments: list[str], out: str = "", err: str = "", umask: int = -1
) -> None:
    from kilter_service.__main__ import main

    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    if umask >= 0:
        os.umask(umask)
    for number, file in ((1, out), (2, err)):
        if file:
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT, 0o600), number)
    main(arguments)
