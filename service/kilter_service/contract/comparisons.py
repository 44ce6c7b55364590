"""Two versions on the same rows, pose by pose: which one is better, by how much, and how often chance alone says so."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import Mm, Strict


class PairedErrors(Strict):
    """What two versions leave of the same rows, base and tool as each version has them. Rows of one pose count once."""

    campaigns: list[str] = Field(description="Ids of the campaigns.")
    held_out: bool = Field(
        description="Whether the rows were held out of both fits; false: there were none, so fitted rows are among them."
    )
    rows: int = Field(description="Rows compared.")
    poses: int = Field(description="Poses compared.")
    counted: Literal["rows", "poses"] = Field(description="What is counted: `rows` where no pose was repeated.")
    better: int = Field(description="On how many b leaves less.")
    worse: int = Field(description="On how many it leaves more.")
    chance: Annotated[float, Field(ge=0, le=1)] = Field(
        description="Probability of so uneven a count if neither were better: exact sign test, two-sided."
    )
    mean_a_mm: Mm = Field(description="Mean error that a leaves, mm.")
    mean_b_mm: Mm = Field(description="Mean error that b leaves, mm.")
    less_mm: Mm = Field(description="How much less b leaves, mean over what is counted, mm; negative: more.")
    low_mm: Mm | None = Field(None, description="Lower end of its 95 % interval, mm; null: too few.")
    high_mm: Mm | None = Field(None, description="Upper end of its 95 % interval, mm; null: too few.")
    sentence: str = Field(description="The same in words, all lengths in one unit.")
