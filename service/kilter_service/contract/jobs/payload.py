"""Jobs of kind ``payload``: what an arm carries, from torques with it and without it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from kilter_service.contract.headlines import HEADLINE, number
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.units import Asked, Kg, PointMm, Stored
from kilter_service.contract.wording import Remark

CampaignName = Annotated[str, Field(min_length=1, max_length=128)]


class PayloadOptions(Asked):
    """Which of the campaigns have no load."""

    empty: Annotated[list[CampaignName], Field(max_length=50)] = Field(
        [],
        description="Campaigns of the job without the load, by name or id; the others are with it. Empty: the last one.",
    )


class TorqueLeft(Stored):
    """What is left of the torques of a joint with the load on, root mean square."""

    joint: int = Field(description="The joint, from 1.")
    unit: str = Field(description="N m, or N of a prismatic joint.")
    empty_arm: float = Field(description="What the model of the empty arm leaves.")
    with_load: float = Field(description="What the model with the load leaves.")


class PayloadResult(Stored):
    """What the arm carries; centre and inertia are null where the mass is not above its own uncertainty."""

    headline: str | None = Field(None, description=HEADLINE)
    mass_kg: Kg | None = Field(None, description="Mass, kg.")
    mass_u95_kg: float | None = Field(None, description="Half of its 95 % interval, kg.")
    centre_mm: PointMm | None = Field(None, description="Centre of mass in the tool frame, mm.")
    centre_u95_mm: PointMm | None = Field(None, description="Half of its 95 % intervals, mm.")
    inertia_kg_m2: list[list[float]] | None = Field(
        None, description="Inertia about the centre in the axes of the tool frame, kg m2."
    )
    inertia_u95_kg_m2: list[list[float]] | None = Field(None, description="Half of its 95 % intervals, kg m2.")
    joints: list[TorqueLeft] | None = Field(None, description="What is left of the torques, by joint.")
    warnings: list[Remark] | None = Field(None, description="What to know before trusting the result.")

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline."""
        if self.mass_kg is None or self.mass_u95_kg is None:
            return
        if self.centre_mm is None or self.centre_u95_mm is None:
            self.headline = f"Nothing is carried that shows: the mass is less than {number(self.mass_u95_kg)} kg."
            return
        place = ", ".join(f"{value:.0f}" for value in self.centre_mm)
        self.headline = (
            f"It carries {self.mass_kg:.3g} kg (95 %: within {number(self.mass_u95_kg)} kg), centre at x, y, z = {place} mm of "
            f"the tool frame (within {number(max(self.centre_u95_mm))} mm).\n{self._describe_joint()}"
        )

    def _describe_joint(self) -> str:
        """The joint that the load shows at most."""
        best = max(self.joints or [], key=lambda one: one.empty_arm / max(one.with_load, 1e-12), default=None)
        if best is None:
            return ""
        return (
            f"Torque error of joint {best.joint} with the load on: {number(best.empty_arm)} -> {number(best.with_load)} "
            f"{best.unit} rms."
        )


PAYLOAD = JobContract(
    "payload",
    noun="weighing of a payload",
    title="Weigh what it carries",
    summary="Weigh what an arm carries, by its joint torques.",
    options=PayloadOptions,
    result=PayloadResult,
    seconds=(2.0, 0.5, 30.0),
    usual=("empty",),
)
