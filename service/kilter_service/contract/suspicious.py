"""Rows of a campaign that look wrong, and who says so."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kilter_service.contract.units import Mm, Strict

SaidBy = Literal["rows", "identification", "search"]


class SuspiciousRow(Strict):
    """A row that looks wrong, as one of those who say so sees it."""

    row: int = Field(description="Row of the campaign, from 1.")
    file: int = Field(description="The file of the campaign that it is in, from 1.")
    file_row: int = Field(description="Its row in that file, from 1.")
    said_by: SaidBy = Field(
        description="`rows`: the rows themselves, before any fit; `identification`, `search`: the job that made a version."
    )
    version_id: str | None = Field(description="The version of that job; null: no job says it.")
    version_name: str = Field(description="Its name; empty: it has none.")
    job_id: str | None = Field(description="The job.")
    mm: Mm | None = Field(description="How far the row is from where it should be, mm; null: not known as a length.")
    sigma: float | None = Field(description="The same in standard deviations; null: not known.")
    weight: float | None = Field(
        description="What it counts in that fit, 0 to 1; null: nothing was fitted, and the row counts."
    )
    held_out: bool = Field(description="Whether the job held it out, and left it out of the errors on held-out rows.")
    why: str = Field(description="What looks wrong, in words.")


class SuspiciousRows(Strict):
    """All rows of a campaign that look wrong, by row; a row may be named by several."""

    campaign: str = Field(description="Id of the campaign.")
    name: str = Field(description="Its name.")
    rows: int = Field(description="Rows of the campaign.")
    count: int = Field(description="How many of them look wrong to somebody.")
    found: list[SuspiciousRow] = Field(
        description="What is said of them, by row, at most 2000 entries: the rest is counted."
    )
    sentence: str = Field(description="The same in words.")
