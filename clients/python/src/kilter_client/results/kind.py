"""What a command must know of a kind of job."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Kind(NamedTuple):
    """A kind of job: what it does, whether it needs campaigns, and of each option its help and what it takes.

    Forms are `flag`, `integer`, `number`, `text`, `names`, `json`, or choices with bars between.
    """

    summary: str
    needs_campaigns: bool
    help: Mapping[str, str]
    forms: Mapping[str, str]
