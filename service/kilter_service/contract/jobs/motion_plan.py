"""Jobs of kind ``motion_plan``: motions that show bodies and friction, to be recorded with their torques."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from kilter_service.contract.headlines import HEADLINE, number
from kilter_service.contract.jobs.check import Seed
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.units import Asked, Stored
from kilter_service.contract.wording import Remark

MOST_MOTIONS = 20
WELL = 100.0  # condition below which every parameter is seen well


class MotionPlanOptions(Asked):
    """What can be asked of motions to record."""

    seconds: Annotated[float, Field(ge=12.0, le=300.0)] = Field(40.0, description="Length of a motion, s, 12 to 300.")
    count: Annotated[int, Field(ge=1, le=MOST_MOTIONS)] = Field(
        3, description="Motions, 1 to 20: a third of them is held out in a search."
    )
    rate_hz: Annotated[float, Field(ge=5.0, le=1000.0)] = Field(50.0, description="Rows a second, Hz, 5 to 1000.")
    speed_deg_s: Annotated[float, Field(gt=0.0, le=360.0)] = Field(
        45.0,
        description="Highest speed of revolute joints, deg/s, above 0, at most 360; it is reached in half a second.",
    )
    speed_mm_s: Annotated[float, Field(gt=0.0, le=5000.0)] = Field(
        100.0, description="Highest speed of prismatic joints, mm/s, above 0, at most 5000."
    )
    seed: Seed = Field(0, description="Seed of the choice, 0 or more.")


class JointRange(Stored):
    """Where a joint goes, and how fast."""

    joint: int = Field(description="The joint, from 1.")
    unit: str = Field(description="deg, or mm of a prismatic joint.")
    lowest: float = Field(description="Lowest value.")
    highest: float = Field(description="Highest value.")
    fastest: float = Field(description="Highest speed, in that unit per second.")


class MotionPlanResult(Stored):
    """Motions from rest to rest, all from one posture and back to it. Collisions are not checked."""

    headline: str | None = Field(None, description=HEADLINE)
    count: int | None = Field(None, description="How many motions.")
    seconds: float | None = Field(None, description="How long they take, with a second of rest between them, s.")
    base_parameters: int | None = Field(None, description="Combinations of masses and inertias that torques can show.")
    condition: float | None = Field(
        None, description="How much less what is seen worst is seen than what is seen best; below 100 is good."
    )
    joints: list[JointRange] | None = Field(None, description="Where each joint goes.")
    csv: str | None = Field(None, description="The motions as a CSV file: `t_s` and joints.")
    warnings: list[Remark] | None = Field(None, description="What to know before driving them.")

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline."""
        if self.count is None or self.condition is None or not self.joints:
            return
        one = self.count == 1
        how = "well" if self.condition < WELL else "in part: let the joints move further or faster"
        self.headline = (
            f"{'One motion' if one else f'{self.count} motions'} in {number(self.seconds or 0.0)} s "
            f"{'shows' if one else 'show'} {self.base_parameters} numbers of the bodies "
            f"and the friction of {len(self.joints)} joints {how} (condition {number(self.condition)}).\n"
            "Next: drive them, record joints and torques, then `kilter upload` and `kilter gap`."
        )


MOTION_PLAN = JobContract(
    "motion_plan",
    noun="plan of motions",
    title="Plan motions",
    summary="Plan motions that show bodies and friction, to record with their torques; needs no campaign.",
    options=MotionPlanOptions,
    result=MotionPlanResult,
    seconds=(5.0, 1.0, 60.0),
    needs_campaigns=False,
    usual=("seconds", "count", "speed_deg_s"),
)
