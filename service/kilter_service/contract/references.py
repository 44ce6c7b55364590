"""References to things by id or name, the names and notes that people give them, and what remains of purged things."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field, model_validator

from kilter_service.contract.units import (
    COMPENSATION,
    INTERVAL,
    TOLERANCE,
    ControllerCompensation,
    IntervalDays,
    Listed,
    Strict,
    ToleranceMm,
)

Kind = Literal["campaign", "version", "job"]
By = Literal["id", "prefix", "name", "latest", "number"]
Title = Annotated[str, Field(max_length=200)]
Notes = Annotated[str, Field(max_length=20_000)]
TITLE = "What people call it, at most 200 characters; unique for its robot while it is in use."
NOTES = "What people noted on it, at most 20000 characters."
RETIRED_AT = "Since when it is out of use; null: it is in use."


class ResolvedReference(Strict):
    """What a prefix, a name or `latest` stands for."""

    kind: Kind = Field(description="What it is.")
    id: str = Field(description="Its full id.")
    robot: str = Field(description="Name of the robot it belongs to.")
    name: str = Field(description="What people call it; empty: it has no name.")
    by: By = Field(description="How it was found: what the reference was.")
    number: int = Field(0, description="Which version of its robot it is, from 1; 0: not a version.")


class Change(Strict):
    """What people call a campaign or a version, and note on it; what is left out stays."""

    name: Title | None = Field(None, description=TITLE)
    notes: Notes | None = Field(None, description=NOTES)


class RobotChange(Strict):
    """What people say of a robot; what is left out stays, and so does its name, which is its address."""

    remarks: Notes | None = Field(None, description="What people noted on the robot, at most 20000 characters.")
    controller_compensation: ControllerCompensation | None = Field(None, description=COMPENSATION)
    tolerance_mm: ToleranceMm | None = Field(None, description=f"{TOLERANCE} Null: none.")
    check_interval_days: IntervalDays | None = Field(None, description=f"{INTERVAL} Null: none.")

    @model_validator(mode="after")
    def _something(self) -> RobotChange:
        if not self.model_fields_set:
            raise ValueError("give remarks, controller_compensation, tolerance_mm or check_interval_days")
        return self


class Tombstone(Strict):
    """What is left of something that was purged."""

    id: str = Field(description="The id it had; a robot's is its name.")
    kind: Literal["campaign", "version", "robot"] = Field(description="What it was.")
    robot: str = Field(description="Name of the robot it belonged to.")
    name: str = Field(description="What it was called.")
    sha256: str = Field(
        description="Of a version its hash, of a robot that of its chain, of a campaign that of its uploads' hashes."
    )
    by: str = Field(description="Who purged it.")
    at: datetime = Field(description="When it was purged.")


class TombstoneList(Listed):
    """What was purged, newest first."""

    tombstones: list[Tombstone] = Field(description="What was purged, newest first.")
