"""Temporary files of tests in memory, where there is room for them.

A test of the server waits ten times for a disk, 4 ms each (median). No test asks what a power cut leaves: a process
that is killed loses nothing that it wrote, on a disk and in memory alike; full, broken and read-only disks are file
systems of their own, or failures that a library feigns.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

IN_MEMORY = Path("/dev/shm")  # noqa: S108 - where Linux has it; files in it are those of pytest, which are private
LEAST_FREE = 4 << 30  # bytes; a run of all tests takes less than one of these


def serves(folder: Path, least_free: int = LEAST_FREE) -> bool:
    """Whether temporary files may be there: a folder with enough room, in which compiled programs may run."""
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        return False
    return not os.statvfs(folder).f_flag & os.ST_NOEXEC and shutil.disk_usage(folder).free >= least_free


def put_in_memory(folder: Path = IN_MEMORY) -> None:
    """Have this process, and those it starts, put their temporary files there, unless TMPDIR says where."""
    if "TMPDIR" not in os.environ and serves(folder):
        os.environ["TMPDIR"] = str(folder)
        tempfile.tempdir = None  # pytest has asked for the folder already
