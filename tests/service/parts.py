"""What the processes of test_fan_out and test_dask compute; they import this module, so it imports little."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_core.errors import OptionError

if TYPE_CHECKING:
    from kilter_core.types import Each, Floats, Progress


def where(task: tuple[float, str], progress: Progress) -> int:
    """Take some seconds; returns in which process."""
    time.sleep(task[0])
    if task[1] == "wrong":
        raise OptionError("there is none", option="x")
    if task[1] == "killed":
        os.kill(os.getpid(), 9)
    return os.getpid()


def killed_once(task: tuple[Path, int, Any], progress: Progress, work: Callable[[Any, Progress], Any]) -> Any:
    """Do the work, unless it is the third part: that kills its process the first time that it is computed."""
    folder, k, inner = task
    if k == 2 and not (folder / "killed").exists():
        (folder / "killed").touch()
        os.kill(os.getpid(), 9)
    return work(inner, progress)


def killing(each: Each, folder: Path) -> Each:
    """What computes as ``each`` does, and has a process killed in the middle."""

    def killing(work: Callable[[Any, Progress], Any], tasks: Sequence[Any], progress: Progress) -> list[Any]:
        dying = partial(killed_once, work=work)
        return each(dying, [(folder, k, task) for k, task in enumerate(tasks)], progress)

    return killing


def doubled(rows: Floats, progress: Progress) -> Floats:
    """Return an answer as large as its task."""
    return 2.0 * rows


def noted(task: tuple[str, int, float], progress: Progress) -> None:
    """Leave a file with the numbers of this part and of its process, and take some seconds."""
    folder, k, seconds = task
    (Path(folder) / f"{k}-{os.getpid()}").touch()
    time.sleep(seconds)


def recorded(case: Any) -> dict[str, Any]:
    """Return a record of the blind benchmark without a hunt, and in which process it was made."""
    return {"name": case.name, "report": None, "seconds": 0.0, "pid": os.getpid()}
