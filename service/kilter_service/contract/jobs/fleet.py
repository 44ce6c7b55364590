"""A fleet job: many robots identified anew by one request, each by a job of its own."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.contract.jobs.kind import NAME, JobError, Progress, State
from kilter_service.contract.units import MAX_NAMED, Fraction, Id, Ids, Listed, Mm, Strict
from kilter_service.contract.versions import Comparison, Objection
from kilter_service.contract.wording import Remark, Title

RobotState = Literal["queued", "running", "succeeded", "failed", "cancelled", "refused"]
HELD_OUT = 0.2


class NewFleetJob(Strict):
    """Identify many robots anew. Nothing is activated."""

    name: Title = Field("", description="Name of the fleet job, its jobs and the versions they make; empty: no name.")
    robots: Ids | None = Field(
        None, description="Names of the robots, at most 1000; null: all that are in use and that the token may see."
    )
    campaigns: Annotated[dict[Id, Ids], Field(max_length=MAX_NAMED)] = Field(
        {},
        description="Ids of the campaigns to use, by robot; of a robot that is not named: those that its active version "
        "was made from and what was measured for identification since, without an active version all that were.",
    )
    validation: Annotated[Fraction, Field(gt=0)] = Field(
        HELD_OUT,
        description="Fraction of the poses that is held out, where no campaign of role `validation` is among the latest.",
    )
    options: IdentifyOptions | None = Field(
        None, description="Options of all identifications; null: for each robot those its active version was made with."
    )

    @model_validator(mode="before")
    @classmethod
    def _no_start(cls, given: Any) -> Any:
        """Refuse a version of one robot for all."""
        options = given.get("options") if isinstance(given, dict) else None
        if isinstance(options, dict) and options.get("start") is not None:
            raise ValueError("options.start is a version of one robot: leave it out")
        return given


class FleetRobot(Strict):
    """What became of a robot of a fleet job."""

    robot: str = Field(description="Name of the robot.")
    state: RobotState = Field(description="State of its job; `refused`: it has none, and `error` says why.")
    job_id: str | None = Field(description="Id of its job; null: it was refused.")
    campaigns: list[str] = Field(description="Ids of the campaigns that are fitted.")
    validation: list[str] | float | None = Field(description="What is held out: campaigns, or a fraction of the poses.")
    version_before: str | None = Field(description="Version that was active when this was asked for; null: none.")
    version_id: str | None = Field(description="The version that was made; null: none yet.")
    held_out_before_mm: Mm | None = Field(
        description="Mean error of the version before, mm, on poses that neither it nor the new one was fitted to; null: "
        "not known, and `warnings` say why."
    )
    held_out_after_mm: Mm | None = Field(description="Mean error of the new version on the same poses, mm.")
    compared: Comparison | None = Field(description="How the two were compared; null: not yet, or not possible.")
    objections: list[Objection] = Field(description="What would refuse the activation of the new version.")
    warnings: list[Remark] = Field(description="What the comparison left out.")
    error: JobError | None = Field(description="Why the robot was refused or its job failed.")


class FleetCounts(Strict):
    """How many robots are in which state."""

    queued: int = Field(0, description="Robots whose job waits.")
    running: int = Field(0, description="Robots whose job computes.")
    succeeded: int = Field(0, description="Robots with a new version.")
    failed: int = Field(0, description="Robots whose job failed.")
    cancelled: int = Field(0, description="Robots whose job was cancelled.")
    refused: int = Field(0, description="Robots that no job was made for.")


class FleetJobSummary(Strict):
    """A fleet job in a list."""

    id: str = Field(description="Id of the fleet job, `flt_` and 16 hexadecimal digits.")
    name: str = Field(description=NAME)
    state: State = Field(
        description="`queued` and `running` become one of the other three; `succeeded`: at least one robot has a new "
        "version, `failed`: none has."
    )
    progress: Progress = Field(description="How far it is, over all robots.")
    robots: int = Field(description="How many robots it is about.")
    counts: FleetCounts = Field(description="How many of them are in which state.")
    created_at: datetime = Field(description="When it was asked for.")
    finished_at: datetime | None = Field(description="When its last job was over; null: not yet.")


class FleetJob(FleetJobSummary):
    """A fleet job with a row for each robot."""

    report: list[FleetRobot] = Field(description="What became of each robot, by name.")


class FleetJobList(Listed):
    """Fleet jobs, newest first."""

    fleet_jobs: list[FleetJobSummary] = Field(description="Fleet jobs, newest first.")
