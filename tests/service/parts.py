"""What the processes of test_processes compute; they import this module, so it imports little."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from kilter_core.errors import OptionError


def where(task: tuple[float, str], progress: Callable[[float, str], None]) -> int:
    """Take some seconds; returns in which process."""
    time.sleep(task[0])
    if task[1] == "wrong":
        raise OptionError("there is none", option="x")
    if task[1] == "killed":
        os.kill(os.getpid(), 9)
    return os.getpid()
