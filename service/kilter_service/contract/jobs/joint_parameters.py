"""Jobs of kind ``joint_parameters``: clearance, backlash and stiffness, measured joint by joint."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.fits import JointMotions, Parameter
from kilter_service.contract.jobs.check import MadeVersion, Seed
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.units import Asked, Deg, Kg, Load, PointMm, Stored

RESOLUTION_DEG = 0.001
Centre = Annotated[PointMm, Field(strict=False)]
JointName = Annotated[str, Field(min_length=1, max_length=128)]


class Reading(Asked):
    """One reading: how far the joint rotated about an axis of its frame beyond the command, up to a constant per series."""

    joint: JointName = Field(description="Name of the joint that the inclinometer sits behind.")
    axis: Literal["x", "y", "z"] = Field(description="Axis of rotation in the joint's frame; z is the joint's own.")
    q_deg: Annotated[list[Deg], Field(max_length=32)] = Field(
        description="Readings of all joints, degrees; mm for prismatic ones."
    )
    reading_deg: Deg = Field(description="What the inclinometer read beyond the command, degrees.")
    payload_kg: Load = Field(0.0, description="Mass at the tool point, kg, 0 or more.")
    payload_com_mm: Centre | None = Field(
        None, description="Centre of that mass in the tool frame, mm; null: the tool point."
    )
    series: int = Field(0, description="Number of the series; the constant of a series is its own.")


class JointParametersOptions(Asked):
    """Readings to evaluate, or a joint to propose configurations for; neither, with campaigns of readings or encoders."""

    readings: Annotated[list[Reading], Field(max_length=100_000)] = Field(
        [], description="Readings of an inclinometer."
    )
    resolution_deg: Annotated[Deg, Field(gt=0)] = Field(
        RESOLUTION_DEG, description="Resolution of the inclinometer, degrees, above 0."
    )
    propose: JointName | None = Field(None, description="Name of the joint to propose configurations for.")
    count: Annotated[int, Field(ge=4, le=200)] = Field(8, description="Configurations to propose, 4 to 200.")
    payloads_kg: Annotated[list[Load], Field(min_length=1, max_length=100)] = Field(
        [0.0], description="Loads at hand, kg, 0 or more."
    )
    payload_com_mm: Centre | None = Field(
        None, description="Of a proposal: centre of these loads in the tool frame, mm; null: the tool point."
    )
    seed: Seed = Field(0, description="Seed of the choice, 0 or more.")


class Configuration(Stored):
    """A configuration to read the inclinometer in."""

    joint: str | None = Field(None, description="Name of the joint.")
    axis: str | None = Field(None, description="Axis of the joint's frame to read about.")
    payload_kg: Kg | None = Field(None, description="Load to carry, kg.")
    payload_com_mm: PointMm | None = Field(None, description="Its centre in the tool frame, mm; null: the tool point.")
    q_deg: list[Deg] | None = Field(None, description="All joints, degrees; mm for prismatic ones.")


class JointParametersResult(MadeVersion):
    """What was measured of the joints, or where to read."""

    measured_by: str | None = Field(None, description="`inclinometer` or `link-side encoder`.")
    parameters: list[Parameter] | None = Field(None, description="Clearance, backlash and stiffness of the joints.")
    joints: list[JointMotions] | None = Field(None, description="What link-side encoders say of each joint.")
    joint: str | None = Field(None, description="The joint that configurations are proposed for.")
    configurations: list[Configuration] | None = Field(None, description="Configurations to read.")
    csv: str | None = Field(None, description="The configurations as a CSV file to fill in.")


JOINT_PARAMETERS = JobContract(
    "joint_parameters",
    noun="measurement of joints",
    title="Measure joints",
    summary="Measure joints by inclinometer readings or link-side encoders, or propose where to read.",
    options=JointParametersOptions,
    result=JointParametersResult,
    seconds=(0.5, 0.1, 10.0),
    instead_of_campaigns=("readings", "propose"),
    usual=("propose", "resolution_deg", "count"),
)
