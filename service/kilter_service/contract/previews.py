"""What would happen: a version before it is activated, a job before it is queued."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kilter_service.contract.units import Celsius, Deg, Mm, Strict


class JointPreview(Strict):
    """The largest correction of a joint."""

    joint: str = Field(description="Name of the joint.")
    largest_deg: Deg | None = Field(
        None, description="Largest correction, degrees; null: prismatic, or nothing was corrected."
    )
    largest_mm: Mm | None = Field(None, description="Largest correction, mm; null: revolute, or nothing was corrected.")
    largest_at: list[float] | None = Field(None, description="The joints there: degrees, mm for prismatic ones.")


class VersionPreview(Strict):
    """How a version would correct, without activating it: what `correct` does with these poses, within its limits."""

    version_id: str = Field(description="Id of the version.")
    within: Literal["campaigns", "limits"] = Field(
        description="Poses looked at: `campaigns`, where the robot was driven before; `limits`, anywhere in its limits."
    )
    poses: int = Field(description="How many poses were looked at.")
    corrected: int = Field(description="How many of them get corrected joints, damped and limited ones among them.")
    damped: int = Field(
        0,
        description="How many of these keep more of their error than is stated: a singularity is near, or out of reach.",
    )
    limited: int = Field(
        0, description="How many of these keep more of their error than is stated because the correction is at a limit."
    )
    refused: dict[str, int] = Field(
        description="The others, by why they would be refused, such as `CORRECTION_TOO_LARGE` for its limits."
    )
    mean_mm: Mm | None = Field(
        description="Mean movement of the tool by the correction, mm; null: nothing was corrected."
    )
    largest_mm: Mm | None = Field(description="Largest movement of the tool by the correction, mm; null: as above.")
    largest_at: list[float] | None = Field(description="The joints there: degrees, mm for prismatic ones.")
    left_mm: Mm | None = Field(
        None, description="The most that a correction leaves of the tool's error by the version, mm; null: as above."
    )
    left_at: list[float] | None = Field(None, description="The joints there: degrees, mm for prismatic ones.")
    joints: list[JointPreview] = Field(description="The largest correction of each joint.")
    unsupported_effects: list[str] = Field(
        description="Ids of its effects that would not be corrected where rows state joints and loads alone, as in a stream."
    )
    corrected_where_stated: dict[str, list[str]] = Field(
        {},
        description="Those of them that rows of a file are corrected for, by id with the columns that rows must state.",
    )
    not_corrected: str = Field("", description="Both in words; empty: nothing is left out.")
    temperature_c: Celsius | None = Field(
        description="Temperature it was looked at with, degrees Celsius; null: not known."
    )
