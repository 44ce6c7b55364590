"""Every kind of job there is, and the models that hold one of any kind."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import or_
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from pydantic import Field

from kilter_service.contract.jobs import check
from kilter_service.contract.jobs.drift import DRIFT
from kilter_service.contract.jobs.evaluate import EVALUATE
from kilter_service.contract.jobs.gap import GAP
from kilter_service.contract.jobs.identify import IDENTIFY
from kilter_service.contract.jobs.joint_parameters import JOINT_PARAMETERS
from kilter_service.contract.jobs.kind import JobContract, JobOf, NewJobOf
from kilter_service.contract.jobs.motion_plan import MOTION_PLAN
from kilter_service.contract.jobs.payload import PAYLOAD
from kilter_service.contract.jobs.plan import PLAN
from kilter_service.contract.jobs.rezero import REZERO

KINDS: Mapping[str, JobContract[Any, Any]] = MappingProxyType(
    {kind.name: kind for kind in (IDENTIFY, GAP, EVALUATE, PLAN, JOINT_PARAMETERS, PAYLOAD, MOTION_PLAN, DRIFT, REZERO)}
)

if TYPE_CHECKING:
    NewJob: TypeAlias = NewJobOf[Any]
    Job: TypeAlias = JobOf[Any, Any]
    JobCheck: TypeAlias = check.JobCheck
else:
    KIND = Field(discriminator="kind")
    NewJob = Annotated[reduce(or_, (kind.request for kind in KINDS.values())), KIND]
    Job = Annotated[reduce(or_, (kind.job for kind in KINDS.values())), KIND]
    JobCheck = Annotated[reduce(or_, (kind.preview for kind in KINDS.values())), KIND]
