"""What people call a version, a job or a campaign: its name, else what it is and when it was made."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Protocol

# Of a job by its kind, of a version none: whoever reads need not know what an id stands for.
JOBS: Mapping[str, str] = {
    "identify": "identification",
    "gap": "search",
    "evaluate": "evaluation",
    "plan": "plan of poses",
    "joint_parameters": "measurement of joints",
    "drift": "check",
    "rezero": "re-zeroing",
}


class Made(Protocol):
    """What was made some time, and may have a name."""

    name: str
    created_at: datetime


def display_name(made: Made) -> str:
    """Return what people call it; to the second, so that two of a minute differ."""
    if made.name:
        return made.name
    kind = getattr(made, "kind", "")
    what = JOBS.get(kind, kind) or ("version" if hasattr(made, "job_id") else "campaign")
    return f"{what} of {made.created_at:%Y-%m-%d %H:%M:%S}"
