"""What the processes of the corrector get when they are spawned, and where each of them begins.

Light on purpose: the supervisor of both starts them before it imports anything heavy itself.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path

from kilter_service.contract.stream_messages import MAX_AGE_NS
from kilter_service.stream.signing.masters import Masters

STREAM, QUERY = "kilter_service.stream.corrector.loop:stream_main", "kilter_service.stream.corrector.queries:query_main"


@dataclass(frozen=True)
class Rules:
    """Bounds that do not belong to a version.

    Clocks of two machines are never compared. The smallest difference between arrival and sending seen so far counts
    as the transit time; the age of a frame is what exceeds that. ``clock_drift`` lets that smallest difference grow again.
    It grows at once when a clock is set back by more than ``set_back_ns``, or when late frames agree within
    ``agree_ns`` on a longer transit time for ``agree_for_ns``. Of ``slots`` streams, one that was good within
    ``idle_ns`` keeps its own.
    """

    max_age_ns: int = MAX_AGE_NS
    clock_drift: float = 200e-6
    set_back_ns: int = 5_000_000
    agree_ns: int = 5_000_000
    agree_for_ns: int = 100_000_000
    recent_ns: int = 1_000_000_000
    time_slack_s: float = 0.1
    ring: int = 256
    slots: int = 256
    idle_ns: int = 10_000_000_000


@dataclass(frozen=True)
class StreamSpec:
    """What the stream process gets when it is spawned; at ``private_endpoint`` it meets the query process.

    ``again`` is where the one before it listened: where the port is left open (0), clients look there first.
    """

    site: str
    instance: str
    listen: str
    private_endpoint: str
    masters: Masters
    unsigned: bool
    zenoh_config: Path | None = None
    rules: Rules = field(default_factory=Rules)
    keys_file: Path | None = None
    again: str | None = None

    def serves_as(self, other: StreamSpec) -> bool:
        """Whether a stream process that was started with ``other`` does what one started with this would."""
        theirs = ("instance", "private_endpoint", "masters", "again")
        return replace(self, **{name: getattr(other, name) for name in theirs}) == other


@dataclass(frozen=True)
class QuerySpec:
    """What the query process gets when it is spawned."""

    site: str
    private_endpoint: str
    masters: Masters
    unsigned: bool
    zenoh_config: Path | None = None


def enter(entry: str, spec: StreamSpec | QuerySpec, pipe: Connection) -> None:
    """Run ``entry`` ("module:function") in the spawned process, which imports it; its parent did not have to."""
    module, _, function = entry.partition(":")
    getattr(importlib.import_module(module), function)(spec, pipe)
