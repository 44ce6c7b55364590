"""Jobs of kind ``identify``: observations into a new parameter version."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from kilter_service.contract.figures import IdentifyFigures
from kilter_service.contract.fits import FitDetails, Metrics, NullDirection, Parameter
from kilter_service.contract.jobs.check import IdentifiabilityCheck
from kilter_service.contract.jobs.job import JobOf
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.jobs.shared import (
    FIX,
    FREE,
    LIMITS,
    NOISE,
    PRIOR,
    REFERENCE,
    SEED,
    START,
    Effects,
    Free,
    Limits,
    MadeVersion,
    Names,
    NoiseMm,
    PriorName,
    ReferenceFrames,
    Seed,
    Version,
)
from kilter_service.contract.methods import MethodName
from kilter_service.contract.units import Asked, Deg, Mm, Percent


class IdentifyOptions(Asked):
    """What can be asked of an identification."""

    level: Literal[1, 2, 3] | None = Field(
        None,
        description="1 joint offsets, 2 geometry, 3 geometry and effects; null: 3 when `effects` are named, else 2.",
    )
    method: MethodName = Field("least_squares", description="The estimator.")
    tilt_first: bool = Field(
        False,
        description="Hold the effects while the geometry is identified: those of the start, else as fitted before it.",
    )
    effects: Effects = Field(
        [], description="Effects to identify, by id or with options; empty: none, at level 3 the thesis's three."
    )
    free: Names = Field([], description=FREE)
    fix: Names = Field([], description=FIX)
    base: Literal["free", "fixed", "removed"] = Field(
        "free", description="Whether the base is fitted; `removed`: only distances between poses count."
    )
    tool: Free = Field("free", description="Whether the tool is fitted.")
    loss: Literal["linear", "huber", "tukey"] = Field(
        "linear", description="`huber` bounds what a wrong row can pull, `tukey` sets it aside and names it."
    )
    noise_mm: NoiseMm | None = Field(None, description=NOISE)
    reference: ReferenceFrames = Field("auto", description=REFERENCE)
    refit: Annotated[list[Literal["base", "tool"]], Field(max_length=2)] | None = Field(
        None,
        description='["base"]: every campaign and session has a base of its own; ["tool"]: a tool (a remounted marker); '
        "[]: all rows share one of each; null: the device decides, and sheets and ball bars have bases of their own.",
    )
    sheet_order: Literal["checked", "given"] | None = Field(
        None,
        description="`given`: the quarter points of drawn sheets are in the right order, do not check; null: `checked`.",
    )
    seed: Seed = Field(0, description=SEED)
    start: Version = Field(None, description=START)
    limits: Limits = Field(None, description=LIMITS)
    search_mm: Annotated[Mm, Field(gt=0)] = Field(
        25.0, description="Half the width of a global search in lengths, mm, above 0."
    )
    search_deg: Annotated[Deg, Field(gt=0)] = Field(
        10.0, description="Half the width of a global search in angles, degrees, above 0."
    )
    intervals: Literal["bootstrap", "profile"] | None = Field(
        None, description="Add 95 % intervals that do not rest on the covariance; null: none."
    )
    masses: Literal["auto", "uncertain", "as_stated"] = Field(
        "auto",
        description="`uncertain`: errors of masses and centres are carried beside effects that follow the load, as "
        "`load_error` does; `as_stated`: masses are exact; `auto`: uncertain, but beside an effect that follows the sign of a "
        "load values are fitted with masses as stated, and sigmas hold what their errors do.",
    )
    mass_sigma_percent: Annotated[Percent, Field(gt=0)] | None = Field(
        None, description="Standard deviation of every mass, percent of it, above 0; null: what the robot says of each."
    )
    com_sigma_mm: Annotated[Mm, Field(gt=0)] | None = Field(
        None,
        description="Standard deviation of each coordinate of every centre of mass, mm, above 0; null: what the robot says.",
    )
    prior: PriorName = Field(None, description=PRIOR)
    socket_distances_mm: dict[
        Annotated[str, Field(pattern=r"^[0-9]+-[0-9]+$", max_length=32)], Annotated[Mm, Field(gt=0)]
    ] = Field({}, description='Known distances between ball sockets, mm, above 0: {"1-2": 400.0}.')


class IdentifyResult(FitDetails, MadeVersion):
    """What an identification found; the version holds the same."""

    parameters: list[Parameter] | None = Field(None, description="Parameters that were identified.")
    null_directions: list[NullDirection] | None = Field(None, description="What the data could not tell.")
    metrics: Metrics | None = Field(None, description="Errors on the rows fitted and on those held out.")
    noise_mm: Mm | None = Field(None, description="Standard deviation of a coordinate of the noise, mm.")
    figures: IdentifyFigures | None = Field(None, description="Figures by name.")


IDENTIFY = JobContract(
    "identify",
    noun="identification",
    title="Identify parameters",
    summary="Identify parameters from campaigns; the result is a new version.",
    options=IdentifyOptions,
    result=IdentifyResult,
    seconds=(1.0, 0.3, 20.0),
    version_option="start",
    takes_folds=True,
    usual=("method", "level", "effects", "loss", "start"),
    uses={"train": "train", "validation": "validation"},
    check=IdentifiabilityCheck,
)
IdentifyJob: TypeAlias = JobOf[IdentifyOptions, IdentifyResult]
