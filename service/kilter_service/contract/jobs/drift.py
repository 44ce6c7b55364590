"""Jobs of kind ``drift``: whether an arm has moved since its version was made."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal, TypeAlias

from pydantic import Field

from kilter_service.contract.fits import StageErrors
from kilter_service.contract.headlines import HEADLINE
from kilter_service.contract.jobs.check import NewFrames, NoiseMm, SetupMm, Version
from kilter_service.contract.jobs.kind import JobContract, JobOf
from kilter_service.contract.units import Asked, Celsius, JointNumber, Mm, PointMm, Stored
from kilter_service.contract.wording import Remark

CauseKind = Literal["zero", "sag", "base", "tool", "scale"]
DriftVerdict = Literal["ok", "moved", "cannot_tell"]


class DriftOptions(Asked):
    """What can be asked of a check."""

    version: Version = Field(None, description="Id of the version to check against; null: the active one.")
    noise_mm: NoiseMm | None = Field(
        None, description="Standard deviation of a coordinate, mm, above 0; null: what the version's fit found."
    )
    new_setup: NewFrames = Field(
        [],
        description='Frames that were set up anew: [], ["base"] or ["base", "tool"]. What looks like them is then not seen.',
    )
    setup_mm: SetupMm | None = Field(
        None,
        description="Standard deviation with which the set-up repeats, mm; 0: it stays in place; null: as earlier checks show.",
    )


class ChangedNumber(Stored):
    """A number that changed."""

    name: str = Field(description="`value`, or of a frame `x`, `y`, `z`, `rx`, `ry`, `rz` in the frame itself.")
    unit: str = Field(description="Its unit: deg, mm, deg/(N m), mm/N, ppm.")
    change: float = Field(description="By how much it changed.")
    u95: float | None = Field(description="Half width of its 95 % interval; null: the rows do not show this number.")
    summed: float | None = Field(
        None,
        description="The change by weights that no temperature changes: what control charts sum. Null: stored without.",
    )
    summed_u95: float | None = Field(
        None,
        description="Half width of the 95 % interval of that: how much it counts. Null: stored without, or not shown.",
    )


class DriftCause(Stored):
    """A cause that was looked at."""

    name: str = Field(description="`zero_3`, `sag_2`, `base`, `tool`, `scale`.")
    kind: CauseKind | None = Field(None, description="What changed.")
    joint: JointNumber | None = Field(None, description="Joint, from 1; null: none.")
    words: str | None = Field(None, description="The cause as people say it.")
    numbers: list[ChangedNumber] | None = Field(None, description="What changed, if this is the cause.")
    gain: float | None = Field(None, description="Chi-square that it explains.")
    bic: float | None = Field(None, description="What it leaves, with a price for its numbers; smaller is better.")
    refuted: bool | None = Field(None, description="Whether the best cause explains what this one leaves.")
    left_mm: list[float] | None = Field(
        None, description="Of the likeliest causes: the errors of `rows`, mm, if this is the cause; null: not computed."
    )


class CheckedRow(Stored):
    """A row of a check: where its tool is, and by how much the version misses it."""

    row: int = Field(description="Its number in the campaign, from 1.")
    at_mm: PointMm = Field(description="Where the version has the tool, mm, in the frame of the measurements.")
    error_mm: PointMm = Field(description="Measured minus predicted, mm.")
    after_mm: PointMm | None = Field(
        None, description="The same, mm, if the likeliest cause is it; null: there is none."
    )


class SmallestChange(Stored):
    """The smallest change of a cause that such rows show in 95 % of the checks."""

    name: str = Field(description="Name of the cause.")
    words: str = Field(description="The cause as people say it.")
    value: float = Field(description="How small; of base and tool a shift in the direction that shows least.")
    unit: str = Field(description="Its unit.")


class DriftResult(Stored):
    """Whether an arm has moved since its version was made, and by what."""

    headline: str | None = Field(None, description=HEADLINE)
    version_id: str | None = Field(None, description="The version that was checked.")
    verdict: DriftVerdict | None = Field(
        None,
        description="`ok`; `moved`: by the one cause; `cannot_tell`: it moved, by one of several or by none of these.",
    )
    sentence: str | None = Field(None, description="The same in words.")
    remedy: str | None = Field(None, description="What to do, or what would settle it; null: nothing.")
    causes: list[DriftCause] | None = Field(None, description="What explains the rows, best first; empty: nothing did.")
    looked_at: list[DriftCause] | None = Field(None, description="All causes that these rows show, best first.")
    rows: list[CheckedRow] | None = Field(
        None, description="The rows, at most 60, the worst of more; null: no instrument saw places."
    )
    p_value: float | None = Field(None, description="Chance of so much from an arm that has not moved.")
    false_alarm: float | None = Field(None, description="Chance of a false alarm at which it says `moved`.")
    chi_square: float | None = Field(None, description="Squared whitened innovation.")
    numbers: int | None = Field(None, description="Numbers that it sums over.")
    poses: int | None = Field(None, description="Distinct poses that counted.")
    lengths: Literal["at_tool", "by_views"] | None = Field(
        None,
        description="Where `misfit_mm` and `noise_mm` are: `at_tool`, or `by_views`, beside its rotation, as sure as a typical "
        "view.",
    )
    misfit_mm: Mm | None = Field(
        None, description="Root mean square distance of measured and predicted points, mm (see `lengths`)."
    )
    noise_mm: Mm | None = Field(
        None, description="Standard deviation of a coordinate that counted as noise, mm (see `lengths`)."
    )
    expected_mm: Mm | None = Field(
        None, description="Standard deviation of a coordinate, mm, by which the fit missed beyond that."
    )
    smallest: list[SmallestChange] | None = Field(None, description="The smallest changes that these rows show.")
    unseen: list[str] | None = Field(None, description="Causes that move nothing that was measured, in words.")
    joint_log: bool | None = Field(
        None, description="Whether nobody measured a place, and rows were compared with each other, in their sockets."
    )
    new_setup: list[str] | None = Field(None, description="Frames that were set up anew.")
    setup_mm: Mm | None = Field(
        None, description="Standard deviation with which the set-up was taken to repeat, mm; null: stored without."
    )
    within_k: float | None = Field(
        None,
        description="By how many K the arm may differ from its temperature at the fit, as far as the check goes; 0: both are "
        "stated, or it makes no difference; null: stored without.",
    )
    scatter: float | None = Field(
        None,
        description="How many times the expected scatter the rows have, at least 1; 1 of a stated noise; null: stored without.",
    )
    refit: list[str] | None = Field(None, description="The same, as an evaluation calls them: fitted to these rows.")
    metrics: dict[str, StageErrors] | None = Field(
        None, description="Errors of the version on the rows, `identified`, by campaign, as an evaluation gives them."
    )
    agreed_at: datetime | None = Field(
        None,
        description="When a check measured before last agreed with the version and showed every cause that may be it otherwise "
        "than these rows; null: none did.",
    )
    temperature_c: Celsius | None = Field(
        None, description="Mean temperature of the rows, degrees Celsius; null: not known."
    )
    fitted_c: tuple[Celsius, Celsius] | None = Field(
        None, description="Lowest and highest temperature, degrees Celsius, of the rows of the fit; null: not known."
    )
    warnings: list[Remark] | None = Field(None, description="What to know before trusting the result.")

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline."""
        if self.sentence is not None:
            self.headline = "\n".join([self.sentence, *([self.remedy] if self.remedy else [])])


DRIFT = JobContract(
    "drift",
    noun="check of an arm",
    title="Check for drift",
    summary="Check whether an arm has moved since its version was made; names one campaign.",
    options=DriftOptions,
    result=DriftResult,
    seconds=(0.2, 0.05, 3.0),
    version_option="version",
    against_fit=True,
    most_campaigns=1,
    watching=True,
    uses={"validation": "train"},
    usual=("version", "new_setup", "setup_mm", "noise_mm"),
)
DriftJob: TypeAlias = JobOf[DriftOptions, DriftResult]
