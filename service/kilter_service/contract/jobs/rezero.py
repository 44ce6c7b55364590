"""Jobs of kind ``rezero``: a version of the one or few parameters that moved."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kilter_service.contract.fits import Metrics, Parameter
from kilter_service.contract.jobs.check import LIMITS, Limits, MadeVersion, NewFrames, NoiseMm, SetupMm, Version
from kilter_service.contract.jobs.drift import DriftCause
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.units import Asked

CauseName = Annotated[str, Field(pattern=r"^((zero|sag)_[1-9][0-9]?|base|tool|scale)$")]


class RezeroOptions(Asked):
    """What can be asked of a re-zeroing."""

    version: Version = Field(None, description="Id of the version to change; null: the active one.")
    causes: Annotated[list[CauseName], Field(max_length=8)] = Field(
        [],
        description="What moved: `zero_3`, `sag_2`, `base`, `tool`; empty: what a check of the rows names, if it is one cause.",
    )
    noise_mm: NoiseMm | None = Field(
        None, description="Standard deviation of a coordinate, mm, above 0; null: what the version's fit found."
    )
    new_setup: NewFrames = Field(
        [],
        description='Frames that were set up anew: [], ["base"] or ["base", "tool"]. The version keeps its own.',
    )
    setup_mm: SetupMm | None = Field(
        None,
        description="Standard deviation with which the set-up repeats, mm; 0: it stays in place; null: as earlier checks show.",
    )
    limits: Limits = Field(None, description=LIMITS)


class RezeroResult(MadeVersion):
    """A version in which the one or few parameters that moved are as these rows say, and all others as before."""

    sentence: str | None = Field(None, description="What was changed, in words.")
    start: str | None = Field(None, description="The version that was changed.")
    causes: list[DriftCause] | None = Field(None, description="What moved.")
    parameters: list[Parameter] | None = Field(None, description="The parameters that changed, as they are now.")
    p_before: float | None = Field(None, description="Chance of the rows by the version that was changed.")
    p_after: float | None = Field(None, description="Chance of the rows by the new version.")
    metrics: Metrics | None = Field(None, description="Errors on these rows.")


REZERO = JobContract(
    "rezero",
    noun="re-zeroing",
    title="Re-zero what moved",
    summary="Make a version of the one or few parameters that moved; names one campaign.",
    options=RezeroOptions,
    result=RezeroResult,
    seconds=(1.0, 0.2, 10.0),
    version_option="version",
    against_fit=True,
    most_campaigns=1,
    watching=True,
    uses={"validation": "train"},
    usual=("version", "causes", "new_setup", "noise_mm"),
)
