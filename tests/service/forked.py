"""`kilterd worker` as a fork of a process that has imported it: a process like any other, three seconds sooner."""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path

# What a worker imports at its start and with its first jobs. None of it starts a thread, so that it may be forked.
IMPORTED = [
    "kilter_service.program",
    "kilter_service.serving",
    "kilter_service.jobs.worker",
    "kilter_core.identify",
    "kilter_core.gap",
    "kilter_core.evaluate",
]


def forked_worker(environment: dict[str, str], folder: Path) -> ForkServerProcess:
    """Return a worker that is started; the process it is a fork of lives as long as this one."""
    context: ForkServerContext = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    process = context.Process(target=_worker, args=(environment, str(folder)))
    process.start()
    return process


def _worker(environment: dict[str, str], folder: str) -> None:
    from kilter_service.__main__ import main

    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    main(["worker"])
