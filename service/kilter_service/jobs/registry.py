"""Every kind of job Kilter can run."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.kind import JobKind
from kilter_service.jobs.kinds.drift import DRIFT
from kilter_service.jobs.kinds.evaluate import EVALUATE
from kilter_service.jobs.kinds.gap import GAP
from kilter_service.jobs.kinds.identify import IDENTIFY
from kilter_service.jobs.kinds.joint_parameters import JOINT_PARAMETERS
from kilter_service.jobs.kinds.plan import PLAN
from kilter_service.jobs.kinds.rezero import REZERO

KINDS: Mapping[str, JobKind] = MappingProxyType(
    {kind.name: kind for kind in (IDENTIFY, GAP, EVALUATE, PLAN, JOINT_PARAMETERS, DRIFT, REZERO)}
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
