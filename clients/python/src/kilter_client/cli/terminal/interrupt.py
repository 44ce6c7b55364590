"""What Ctrl-C leaves: one sentence with what is stored and how to continue, and exit code 130."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

from kilter_client.errors import KilterError

CODE = 130
UNKNOWN = (
    "Interrupted. The server finishes what it had begun: "
    "`kilter server jobs` and `kilter measure campaigns ROBOT` show what is there."
)


class InterruptedCommandError(KilterError):
    """Ctrl-C, with what it left behind."""

    default_code: ClassVar[str] = "interrupted"
    default_title: ClassVar[str] = "Interrupted"


@contextmanager
def on_interrupt(tell: Callable[[], str]) -> Iterator[None]:
    """Say what ``tell`` returns when the person presses Ctrl-C inside.

    Raises:
        InterruptedCommandError: Ctrl-C was pressed.

    """
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedCommandError(f"Interrupted: {tell()}") from None


def job_goes_on(job: Mapping[str, Any] | str) -> str:
    """Say that a job goes on, and the commands for it; a text is its name or id."""
    named = shlex.quote(job if isinstance(job, str) else job_name(job))
    return (
        f"job {named} continues at the server. `kilter server jobs watch {named}` follows it, "
        f"`kilter server jobs cancel {named}` stops it."
    )


def job_name(job: Mapping[str, Any]) -> str:
    """Return what a job is called; where a server of an earlier release says nothing, its id."""
    return str(job.get("name") or job["id"])


def fleet_goes_on(fleet_id: str) -> str:
    """Say that a fleet job goes on, and the commands for it."""
    return (
        f"fleet job {fleet_id} continues at the server. `kilter robot fleet watch {fleet_id}` follows it, "
        f"`kilter robot fleet cancel {fleet_id}` stops it."
    )
