"""The work of every kind of job that the contract declares."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from kilter_service.contract.jobs.registry import KINDS as DECLARED
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.kind import JobKind

KINDS: Mapping[str, JobKind] = MappingProxyType(
    {name: import_module(f"kilter_service.jobs.kinds.{name}").KIND for name in DECLARED}
)


def get_job_kind(name: str) -> JobKind:
    """Return the kind of a name.

    Raises:
        ServiceError: Kilter has no such kind.

    """
    if name not in KINDS:
        raise ServiceError(
            f"There is no job of kind {name!r}. There are: {', '.join(KINDS)}.", code="kind_unavailable", kinds=[*KINDS]
        )
    return KINDS[name]
