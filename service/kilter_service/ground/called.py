"""What people call a version, a job or a campaign: its name or number, else what it is and when it was made."""

from __future__ import annotations

from datetime import datetime
from typing import Protocol

from kilter_service.contract.jobs.registry import KINDS


class Made(Protocol):
    """What was made some time, and may have a name."""

    name: str
    created_at: datetime


def display_name(made: Made) -> str:
    """Return what people call it: its name, a version's number, else when it was made.

    To the second, so that two of a minute differ.
    """
    if made.name:
        return made.name
    if number := getattr(made, "number", 0):
        return f"{getattr(made, 'robot', '')} v{number}"
    # Of a job by its kind, of a version none: whoever reads need not know what an id stands for.
    kind = KINDS.get(getattr(made, "kind", ""))
    what = "version" if hasattr(made, "job_id") else "campaign"
    if kind is not None:
        what = kind.called or kind.noun
    return f"{what} of {made.created_at:%Y-%m-%d %H:%M:%S}"
