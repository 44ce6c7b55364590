"""Effects at joints with their options, made from core/kilter_core/effects by `make contract`: change them there."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import Asked, JointNumber, unit


class _AtJoints(Asked):
    joints: Annotated[list[JointNumber], Field(min_length=1, max_length=32)] | None = Field(
        None, description="Joints it acts on, from 1; null: all that it can act on."
    )


class ClearanceTiltEffect(_AtJoints):
    """Tilt of fixed size towards the transverse load, by joint clearance."""

    id: Literal["clearance_tilt"] = Field(description="Id of the effect.")
    share: Literal["thesis", "vector"] = Field(
        "thesis",
        description="How the load is shared among x and y: `thesis` (eq. 5.16) or `vector`, independent of the joint frame's rotation.",
    )
    softening_nm: Annotated[float, unit("N m", ge=0.0)] | list[Annotated[float, unit("N m", ge=0.0)]] = Field(
        0.0,
        description="Half-width over which the sign of the load changes, N m, 0 or more; one for all joints, or one for each.",
    )


class BacklashEffect(_AtJoints):
    """Reversal error with the direction of the joint's last motion."""

    id: Literal["backlash"] = Field(description="Id of the effect.")


class BacklashLoadEffect(_AtJoints):
    """Backlash on the side of the axial load moment."""

    id: Literal["backlash_load"] = Field(description="Id of the effect.")
    softening_nm: Annotated[float, unit("N m", ge=0.0)] | list[Annotated[float, unit("N m", ge=0.0)]] = Field(
        0.0,
        description="Half-width over which the sign of the load changes, N m, 0 or more; one for all joints, or one for each.",
    )
    prior_sigma_rad: Annotated[float, unit("rad", ge=1e-06, le=0.035)] = Field(
        0.0017453292519943296,
        description="Standard deviation of the prior of half the backlash, rad (of a prismatic joint per 0.1 m). Where the load keeps its sign the prior decides between backlash and the joint's zero: say 0.017 for hobby servos.",
    )


class AxialComplianceEffect(_AtJoints):
    """Joint compliance about the axis, proportional to the load moment."""

    id: Literal["axial_compliance"] = Field(description="Id of the effect.")


class RadialComplianceEffect(_AtJoints):
    """Tilt of the bearing in proportion to the transverse load moment."""

    id: Literal["radial_compliance"] = Field(description="Id of the effect.")


class EccentricityEffect(_AtJoints):
    """Once-per-revolution error of a joint: encoder disc or output gear off centre."""

    id: Literal["eccentricity"] = Field(description="Id of the effect.")


class SecondHarmonicEffect(_AtJoints):
    """Twice-per-revolution error of a joint: coupling or ovality."""

    id: Literal["second_harmonic"] = Field(description="Id of the effect.")


class GearErrorEffect(_AtJoints):
    """Cyclic transmission error of the gear at multiples of the motor's turn."""

    id: Literal["gear_error"] = Field(description="Id of the effect.")
    orders: list[float] = Field([1, 2], description="Multiples of the motor's turn; fractions are allowed.")
    ratios: list[float] | None = Field(None, description="Gear ratios of the joints named; null: the robot's.")


class EncoderScaleEffect(_AtJoints):
    """Scale error of a joint reading: gear ratio or encoder pitch."""

    id: Literal["encoder_scale"] = Field(description="Id of the effect.")


class JointCouplingEffect(_AtJoints):
    """A joint follows another: residual coupling of a wrist."""

    id: Literal["joint_coupling"] = Field(description="Id of the effect.")
    drivers: list[JointNumber] | None = Field(
        None, description="For each of the joints the joint that it follows, from 1; null: the one before it."
    )


class GravitySpringEffect(_AtJoints):
    """Torque of a balancer spring through the compliance of its joint."""

    id: Literal["gravity_spring"] = Field(description="Id of the effect.")
    arms_m: list[Annotated[float, unit("m")]] | None = Field(
        None,
        description="Distances of the spring's two pins from the axis, m; null: the effect cannot be distinguished from eccentricity.",
    )
    angle_rad: Annotated[float, unit("rad")] = Field(0.0, description="Angle between the pins at q = 0, rad.")
    free_length_m: Annotated[float, unit("m", ge=0.0)] = Field(
        0.0, description="Length of the spring without load, m, 0 or more."
    )


class LinkBendingEffect(_AtJoints):
    """Bending of a link under its own weight and the load at its end."""

    id: Literal["link_bending"] = Field(description="Id of the effect.")
    directions: list[list[float]] | None = Field(
        None,
        description="Direction of each link's shaft in the frame of its joint; null: to the next joint, across parallel axes.",
    )
    centres_m: list[Annotated[float, unit("m")]] | None = Field(
        None, description="Where along each link's shaft its centre of mass lies, m; null: from the robot's links."
    )


class LinkTorsionEffect(_AtJoints):
    """Twist of a link about its own long axis under the moment it carries."""

    id: Literal["link_torsion"] = Field(description="Id of the effect.")
    directions: list[list[float]] | None = Field(
        None,
        description="Direction of each link's shaft in the frame of its joint; null: to the next joint, across parallel axes.",
    )
    centres_m: list[Annotated[float, unit("m")]] | None = Field(
        None, description="Where along each link's shaft its centre of mass lies, m; null: from the robot's links."
    )


class FrictionWindupEffect(_AtJoints):
    """Wind-up of the drive by friction, on the side of the last motion."""

    id: Literal["friction_windup"] = Field(description="Id of the effect.")
    prior_sigma_rad: Annotated[float, unit("rad", ge=1e-06, le=0.035)] = Field(
        0.0008726646259971648,
        description="Standard deviation of the prior of the wind-up, rad (of a prismatic joint per 0.1 m): that of a hobby servo is its friction over its stiffness, some 0.005.",
    )


class TrackingLagEffect(_AtJoints):
    """Servo lag of a joint behind its setpoint."""

    id: Literal["tracking_lag"] = Field(description="Id of the effect.")


class ZeroDriftEffect(_AtJoints):
    """Zero of a joint moves with time."""

    id: Literal["zero_drift"] = Field(description="Id of the effect.")
    t0_s: Annotated[float, unit("s")] | None = Field(
        None, description="When the zeros were right, s on the clock of the rows; null: the earliest row."
    )


class ZeroThermalEffect(_AtJoints):
    """Zero of a joint moves with temperature."""

    id: Literal["zero_thermal"] = Field(description="Id of the effect.")
    reference_c: Annotated[float, unit("degC", gt=-273.15)] = Field(
        20.0, description="Temperature T0 at which the geometry holds, degrees Celsius."
    )


class LinkGrowthEffect(_AtJoints):
    """One link grows with temperature."""

    id: Literal["link_growth"] = Field(description="Id of the effect.")
    reference_c: Annotated[float, unit("degC", gt=-273.15)] = Field(
        20.0, description="Temperature T0 at which the geometry holds, degrees Celsius."
    )


class ZeroStepEffect(_AtJoints):
    """Zero of a joint jumped once, between two rows."""

    id: Literal["zero_step"] = Field(description="Id of the effect.")
    at_s: Annotated[float, unit("s")] | None = Field(None, description="When it happened, s on the clock of the rows.")
    at_row: int | None = Field(None, description="First row after it, counted from 1 as measured.")


class HardeningEffect(_AtJoints):
    """Gear gets stiffer under load, beside its compliance."""

    id: Literal["hardening"] = Field(description="Id of the effect.")


class DirectionComplianceEffect(_AtJoints):
    """Compliance differs with the direction of approach."""

    id: Literal["direction_compliance"] = Field(description="Id of the effect.")


class ReadingTiltEffect(_AtJoints):
    """Encoder reads the tilt of its own joint as rotation."""

    id: Literal["reading_tilt"] = Field(description="Id of the effect.")


class StraightnessEffect(_AtJoints):
    """Carriage of a prismatic joint moves across its axis along the travel."""

    id: Literal["straightness"] = Field(description="Id of the effect.")
    orders: list[int] = Field([2, 3], description="Orders of the polynomials over the range of the joint.")
    centres: list[float] | None = Field(
        None, description="Middle of each joint's range, rad or m; null: from the rows."
    )
    halves: list[float] | None = Field(None, description="Half of each joint's range, rad or m; null: from the rows.")


class GuideRotationEffect(_AtJoints):
    """Carriage of a prismatic joint pitches, yaws and rolls along the travel."""

    id: Literal["guide_rotation"] = Field(description="Id of the effect.")
    orders: list[int] = Field([1, 2, 3], description="Orders of the polynomials over the range of the joint.")
    centres: list[float] | None = Field(
        None, description="Middle of each joint's range, rad or m; null: from the rows."
    )
    halves: list[float] | None = Field(None, description="Half of each joint's range, rad or m; null: from the rows.")


class TelescopeBendingEffect(_AtJoints):
    """Bending of an arm that a prismatic joint extends, under the load at its end."""

    id: Literal["telescope_bending"] = Field(description="Id of the effect.")
    roots_m: list[Annotated[float, unit("m")]] | None = Field(
        None,
        description="Reading of each joint at which nothing stands out of its guide, m; null: the lower end of its travel.",
    )


class UnknownSmoothCurveEffect(_AtJoints):
    """Smooth error curve of a joint without a known cause."""

    id: Literal["unknown_smooth_curve"] = Field(description="Id of the effect.")
    orders: list[int] = Field([1, 2, 3, 4, 5], description="Orders of the polynomials over the range of the joint.")
    centres: list[float] | None = Field(
        None, description="Middle of each joint's range, rad or m; null: from the rows."
    )
    halves: list[float] | None = Field(None, description="Half of each joint's range, rad or m; null: from the rows.")


class UnknownJointCurveEffect(_AtJoints):
    """Error curve of a joint without a known cause."""

    id: Literal["unknown_joint_curve"] = Field(description="Id of the effect.")
    orders: list[int] = Field(
        [3, 4, 5, 6], description="Waves per revolution; empty: only the product with the partner."
    )
    partner: JointNumber | None = Field(None, description="Joint whose angle multiplies the curve, from 1; null: none.")
