"""Campaigns and uploads."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from kilter_service.contract.fits import Remark
from kilter_service.contract.references import RETIRED_AT
from kilter_service.contract.units import Celsius, Listed, Load, Name, Newton, NewtonMetre, PointMm, Strict

Role = Literal["train", "validation", "confirmation"]
Text = Annotated[str, Field(max_length=200)]
ODD = "What looks odd in the rows and may be right: they are stored."
SHA256 = "SHA-256 of the bytes that were sent, 64 hexadecimal digits."


class Conditions(Strict):
    """What held during the whole campaign; a column of the rows takes precedence over it."""

    payload_kg: Load | None = Field(None, description="Mass at the tool point, kg, 0 or more; null: not known.")
    payload_com_mm: PointMm | None = Field(
        None, description="Centre of the payload in the tool frame, mm; null: the tool point."
    )
    temperature_c: Celsius | None = Field(None, description="Temperature of the arm, degrees Celsius.")
    tool_force_n: tuple[Newton, Newton, Newton] | None = Field(
        None, description="Force on the tool point in the tool frame, N."
    )
    tool_moment_nm: tuple[NewtonMetre, NewtonMetre, NewtonMetre] | None = Field(
        None, description="Moment on the tool point in the tool frame, N m."
    )


class _Campaign(Strict):
    name: Annotated[Text, Field(min_length=1)] = Field(description="Name for people, at most 200 characters.")
    device: Text = Field(
        "",
        description="What it was measured with; `pencil`, `sheet` and `ballbar` have a frame of their own every time.",
    )
    role: Role = Field("train", description="What it is meant for; a job may use it otherwise.")
    conditions: Conditions = Field(Conditions(), description="What held during the whole campaign.")
    notes: Annotated[str, Field(max_length=20_000)] = Field("", description="Whatever else is worth knowing.")
    measured_at: AwareDatetime | None = Field(
        None, description="When its last row was measured, with the time zone; null: not stated."
    )
    instrument: Name | None = Field(
        None,
        description="Name of the instrument it was measured with, as stored (`/v1/instruments`); null: not stated.",
    )
    staged: bool = Field(
        False, description="Whether its parts come one by one, and it is hidden until they are all there."
    )


class NewCampaign(_Campaign):
    """A campaign to measure."""

    numbered: bool = Field(
        False, description="Whether a number is put behind the name when another campaign in use has it."
    )


class StoredFile(Strict):
    """A file of observations."""

    sha256: str = Field(description=SHA256)
    rows: int = Field(description="Rows of the file.")
    columns: list[str] = Field(description="Columns of the file, in its order.")


class Upload(StoredFile):
    """A stored file of observations."""

    media_type: str = Field(description="Media type it was sent as.")
    created_at: datetime = Field(description="When it was stored.")


class Campaign(_Campaign):
    """A campaign and what was uploaded to it."""

    id: str = Field(description="Id of the campaign, `cmp_` and 16 hexadecimal digits.")
    robot: str = Field(description="Name of its robot.")
    created_at: datetime = Field(description="When it was added.")
    retired_at: datetime | None = Field(None, description=RETIRED_AT)
    rows: int = Field(description="Rows of all its uploads.")
    uploads: list[Upload] = Field(description="Files stored, oldest first.")
    warnings: list[Remark] = Field([], description="What the instrument's certificate has against it.")


class Parts(Strict):
    """The content hashes of all parts of a staged campaign."""

    sha256: Annotated[
        list[Annotated[str, Field(pattern="^[0-9a-f]{64}$")]], Field(min_length=1, max_length=100_000)
    ] = Field(description="SHA-256 of each part, 64 hexadecimal digits.")


class CampaignList(Listed):
    """The campaigns of a robot, oldest first."""

    campaigns: list[Campaign] = Field(description="Campaigns, oldest first.")


class Uploaded(StoredFile):
    """What an upload became; ``new`` is false when the same bytes were there already."""

    campaign_id: str = Field(description="Campaign it went to.")
    total_rows: int = Field(description="Rows the campaign has now.")
    new: bool = Field(description="False when the same bytes were there already.")
    warnings: list[Remark] = Field([], description=ODD)


class CheckedRows(Strict):
    """What an upload to a robot would take; nothing was stored."""

    rows: int = Field(description="Rows of the file.")
    columns: list[str] = Field(description="Columns of the file, in its order.")
    warnings: list[Remark] = Field([], description=ODD)
