"""What stands for an id, what people call and note of things, and what is left of what was purged."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from service.contract.units import Strict

Kind = Literal["campaign", "version", "job"]
Title = Annotated[str, Field(max_length=200, description="What people call it; unique for its robot while not retired")]
Notes = Annotated[str, Field(max_length=20_000, description="What people noted on it")]
RetiredAt = Annotated[datetime | None, Field(description="Since when it is out of use; null while it is in use")]


class Reference(Strict):
    """What a prefix, a name or `latest` stands for."""

    kind: Annotated[Kind, Field(description="What it is")]
    id: Annotated[str, Field(description="Its full id")]
    robot: Annotated[str, Field(description="The robot it belongs to")]
    name: Annotated[str, Field(description="Its name, empty when it has none")]
    by: Annotated[
        Literal["id", "prefix", "name", "latest"], Field(description="How it was found: what the reference was")
    ]


class Change(Strict):
    """What people call a campaign or a version, and note on it; what is left out stays."""

    name: Title | None = None
    notes: Notes | None = None


class RobotChange(Strict):
    """What people note on a robot; its name is its address and stays."""

    remarks: Annotated[Notes, Field(description="What people noted on the robot")]


class Tombstone(Strict):
    """What is left of something that was purged."""

    id: Annotated[str, Field(description="The id it had; a robot's is its name")]
    kind: Annotated[Literal["campaign", "version", "robot"], Field(description="What it was")]
    robot: Annotated[str, Field(description="The robot it belonged to")]
    name: Annotated[str, Field(description="What it was called")]
    sha256: Annotated[
        str,
        Field(description="Of a version its hash, of a robot that of its chain, of a campaign that of its uploads'"),
    ]
    by: Annotated[str, Field(description="Who purged it")]
    at: Annotated[datetime, Field(description="When it was purged")]


class TombstoneList(Strict):
    """What was purged, newest first."""

    tombstones: list[Tombstone]
