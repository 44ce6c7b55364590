"""Jobs of kind ``payload``: what an arm carries, from torques with it and without it, or from a force sensor at the wrist."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from kilter_service.contract.headlines import HEADLINE, number
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.units import Asked, Kg, PointMm, Stored
from kilter_service.contract.wording import Remark

ThreeNumbers = tuple[float, float, float]
CampaignName = Annotated[str, Field(min_length=1, max_length=128)]


class PayloadOptions(Asked):
    """Which of the campaigns have no load, or where a force sensor is."""

    empty: Annotated[list[CampaignName], Field(max_length=50)] = Field(
        [],
        description="Campaigns of the job without the load, by name or id; the others are with it. Empty: the last one.",
    )
    by: Literal["torques", "wrench"] | None = Field(
        None,
        description="What weighs: joint torques, or a force sensor at the wrist that reads fx_n ... mz_nm. Null: what the "
        "campaigns have; with both it must be said.",
    )
    sensor_mm: Annotated[PointMm, Field(strict=False)] | None = Field(
        None, description="By wrench: origin of the sensor in the axes of the flange, mm; null: the flange."
    )


class TorqueLeft(Stored):
    """What is left of the torques of a joint with the load on, root mean square."""

    joint: int = Field(description="The joint, from 1.")
    unit: str = Field(description="N m, or N of a prismatic joint.")
    empty_arm: float = Field(description="What the model of the empty arm leaves.")
    with_load: float = Field(description="What the model with the load leaves.")


class WristSensor(Stored):
    """A force sensor at the wrist, by gravity on what it carries."""

    bias_n: ThreeNumbers = Field(description="Force that it reads without any, N.")
    bias_u95_n: ThreeNumbers = Field(description="Half of its 95 % intervals, N.")
    bias_nm: ThreeNumbers = Field(description="Moment that it reads without any, N m.")
    bias_u95_nm: ThreeNumbers = Field(description="Half of its 95 % intervals, N m.")
    mounting_deg: ThreeNumbers = Field(
        description="Rotation vector from the axes of the flange to those of the sensor, degrees."
    )
    mounting_u95_deg: ThreeNumbers | None = Field(
        description="Half of its 95 % intervals, degrees. Null: gravity did not rotate far enough to tell, so that the axes of "
        "the flange were believed."
    )
    left_n: float = Field(description="What is left of the force, rms of its components, N.")
    left_nm: float = Field(description="What is left of the moment, N m.")
    touched_rows: int = Field(description="Rows that were left out because something else touched the tool.")


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
    sensor: WristSensor | None = Field(None, description="By wrench: what the sensor adds of its own.")
    csv: str | None = Field(
        None,
        description="By wrench: t_s or row, and the wrench without bias, gravity and inertia in the axes of the sensor; at "
        "most 20 000 rows, of a log at 20 a second and below 5 Hz.",
    )
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
            f"the tool frame (within {number(max(self.centre_u95_mm))} mm).\n"
            f"{self._describe_joint() if self.sensor is None else self._describe_sensor(self.sensor)}"
        )

    def _describe_sensor(self, sensor: WristSensor) -> str:
        """Its bias, and how it is mounted."""
        force, moment = (", ".join(number(x) for x in one) for one in (sensor.bias_n, sensor.bias_nm))
        rotated = ", ".join(f"{x:.1f}" for x in sensor.mounting_deg)
        mounted = "" if sensor.mounting_u95_deg is None else f", rotated by {rotated} deg about x, y, z of the flange"
        return f"Bias of the sensor: {force} N and {moment} N m{mounted}."

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
    summary="Weigh what an arm carries, by torques or a force sensor.",
    options=PayloadOptions,
    result=PayloadResult,
    seconds=(2.0, 0.5, 30.0),
    usual=("empty",),
)
