"""Whether an arm keeps a tolerance, by ISO 14253-1, on rows that no fit used."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kilter_service.contract.budgets import Budget
from kilter_service.contract.fits import Errors
from kilter_service.contract.units import Mm, Strict
from kilter_service.contract.words import Remark

Decision = Literal["accepted", "rejected", "not_proved"]
Span = tuple[Mm, Mm]


class JudgedCampaign(Strict):
    """Rows of a campaign that the version was not fitted to, and what it leaves of them."""

    id: str = Field(description="Id of the campaign.")
    name: str = Field(description="Its name.")
    when: str = Field(description="When it was measured, in words.")
    instrument: str | None = Field(description="Name of the instrument; null: none is named.")
    rows: int = Field(description="Rows judged.")
    sha256: list[str] = Field(description="SHA-256 of its files.")
    refit: list[str] = Field(description="Frames that were fitted to these rows; empty: none.")
    before: Errors = Field(description="Errors of the nominal robot, base and tool fitted to these rows.")
    after: Errors = Field(description="Errors of the version.")
    largest_mm: Mm = Field(description="Largest error of a row, mm.")
    row: int = Field(description="Row of the campaign that decides, from 1.")
    error_mm: Mm = Field(description="Its error, mm.")
    guard_band_mm: Mm = Field(description="Expanded uncertainty of that error, k = 2, mm: the guard band.")
    provable_mm: Mm = Field(description="Smallest tolerance that the rows prove, mm.")
    budget: Budget = Field(description="What is not known of these rows.")
    at_mm: list[tuple[Mm, Mm, Mm]] = Field(description="Measured places, mm; of many rows 500, evenly chosen.")
    error_at_mm: list[Mm] = Field(description="The error at each of them, mm.")


class Acceptance(Strict):
    """A decision about a tolerance of the position of the tool."""

    robot: str = Field(description="Name of the robot.")
    robot_sha256: str = Field(description="SHA-256 of the robot's chain.")
    version_id: str = Field(description="The version that was judged.")
    version_name: str = Field(description="What people call it; empty: it has no name.")
    version_sha256: str = Field(description="Its SHA-256.")
    tolerance_mm: Mm = Field(description="Tolerance of the distance of the tool from where it should be, mm.")
    decision: Decision = Field(
        description="`accepted`: every error and its guard band are within the tolerance; `rejected`: an error is beyond it "
        "by its guard band; `not_proved`: neither can be proved."
    )
    rule: str = Field(description="The decision rule, in words.")
    sentence: str = Field(description="The decision, in words.")
    rows: int = Field(description="Rows judged; no fit of the version or of one that it continues used them.")
    provable_mm: Mm = Field(description="Smallest tolerance that all rows prove, mm.")
    span_mm: dict[str, Span] = Field(description="From where to where the rows were measured, by axis, mm.")
    campaigns: list[JudgedCampaign] = Field(description="The rows by campaign, the one that decides first.")
    lacking: list[Remark] = Field(
        description="Why nothing can be proved whatever the numbers; empty: nothing is lacking."
    )
    warnings: list[Remark] = Field(description="What to know before trusting the decision.")
