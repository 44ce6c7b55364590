"""A process that has numba imported and warm, and nothing of Kilter: forked, half a second sooner than one that starts."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path

import numba

FORKS = get_context("forkserver")
FORKS.set_forkserver_preload([__name__])
numba.njit(lambda x: 2 * x)(1)


def start(code: str, environment: Mapping[str, str], out: Path, err: Path) -> BaseProcess:
    """Begin to run the code in a process with this environment, which writes to these files."""
    process = FORKS.Process(target=_run, args=(code, dict(environment), str(out), str(err)))
    process.start()
    return process


def _run(code: str, environment: Mapping[str, str], *files: str) -> None:
    for descriptor, path in enumerate(files, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT, 0o600), descriptor)
    assert not [name for name in sys.modules if name.startswith("kilter")]
    os.environ.clear()
    os.environ.update(environment)
    sys.path.insert(0, environment["PYTHONPATH"])
    sys.dont_write_bytecode = True
    numba.config.reload_config()
    exec(code, {})  # noqa: S102
