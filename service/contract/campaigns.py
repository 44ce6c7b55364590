"""Campaigns and uploads."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from service.contract.references import RetiredAt
from service.contract.units import Strict, Vector

Role = Literal["train", "validation", "confirmation"]
Text = Annotated[str, Field(max_length=200)]


class Conditions(Strict):
    """What held during the whole campaign; a column of the rows goes before it."""

    payload_kg: Annotated[FiniteFloat, Field(ge=0)] | None = None
    payload_com_mm: Vector | None = None
    temperature_c: Annotated[FiniteFloat, Field(gt=-273.15)] | None = None
    tool_force_n: Vector | None = None
    tool_moment_nm: Vector | None = None


class NewCampaign(Strict):
    """A campaign to measure."""

    name: Annotated[Text, Field(min_length=1)]
    device: Text = ""
    role: Role = "train"
    conditions: Conditions = Conditions()
    notes: Annotated[str, Field(max_length=20_000)] = ""
    staged: bool = False
    numbered: Annotated[bool, Field(description="Put a number behind the name when another campaign has it")] = False


class Upload(Strict):
    """A stored file of observations."""

    sha256: str
    rows: int
    columns: list[str]
    media_type: str
    created_at: datetime


class Campaign(Strict):
    """A campaign and what was uploaded to it."""

    name: Text
    device: Text
    role: Role
    conditions: Conditions
    notes: str
    staged: bool
    retired_at: RetiredAt = None
    id: str
    robot: str
    created_at: datetime
    rows: int
    uploads: list[Upload]


class Parts(Strict):
    """The content hashes of all parts of a staged campaign."""

    sha256: Annotated[list[Annotated[str, Field(pattern="^[0-9a-f]{64}$")]], Field(min_length=1, max_length=100_000)]


class CampaignList(Strict):
    """The campaigns of a robot, oldest first."""

    campaigns: list[Campaign]


class Uploaded(Strict):
    """What an upload became; ``new`` is false when the same bytes were there already."""

    campaign_id: str
    sha256: str
    rows: int
    columns: list[str]
    total_rows: int
    new: bool
