"""Effects on the whole arm with their options, made from core/kilter_core/effects by `make contract`: change them there."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import Asked, JointNumber, unit


class _Whole(Asked):
    joints: None = Field(None, description="Null: the effect does not act at joints.")


class BaseComplianceEffect(_Whole):
    """Tilt of base or its mount under the moment of the arm."""

    id: Literal["base_compliance"] = Field(description="Id of the effect.")


class ThermalGrowthEffect(_Whole):
    """Links grow with temperature."""

    id: Literal["thermal_growth"] = Field(description="Id of the effect.")
    reference_c: Annotated[float, unit("degC", gt=-273.15)] = Field(
        20.0, description="Temperature T0 at which the geometry holds, degrees Celsius."
    )


class PayloadErrorEffect(_Whole):
    """Mass or centre of the payload not as stated, seen through what follows the load."""

    id: Literal["payload_error"] = Field(description="Id of the effect.")
    compliances: list[float] = Field(
        [],
        description="Compliance of each joint, rad/(N m), as identified before; empty: the effects beside it read the changed load.",
    )


class TimeOffsetEffect(_Whole):
    """Delay between the joint readings and the measured positions."""

    id: Literal["time_offset"] = Field(description="Id of the effect.")


class DriftEffect(_Whole):
    """Slow motion of the base or of the instrument with time."""

    id: Literal["drift"] = Field(description="Id of the effect.")
    t0_s: Annotated[float, unit("s")] | None = Field(
        None,
        description="When the base was where the geometry says, s on the clock of the rows; null: the earliest row.",
    )


class MeasurementScaleEffect(_Whole):
    """Scale error of the instrument."""

    id: Literal["measurement_scale"] = Field(description="Id of the effect.")


class SessionShiftEffect(_Whole):
    """Markers or reflector mounted anew between sessions."""

    id: Literal["session_shift"] = Field(description="Id of the effect.")
    sessions: list[int] = Field(
        [], description="Session numbers, the reference first; a session that is not named counts as the reference."
    )


class SettlingEffect(_Whole):
    """Base or instrument settles exponentially."""

    id: Literal["settling"] = Field(description="Id of the effect.")
    tau_s: Annotated[float, unit("s", gt=0.0)] | None = Field(
        None, description="Time constant, s, above 0; null: a fifth of the rows' time."
    )
    t0_s: Annotated[float, unit("s")] | None = Field(
        None, description="When it began, s on the clock of the rows; null: the earliest row."
    )


class RandomWalkEffect(_Whole):
    """Base or instrument wanders with time."""

    id: Literal["random_walk"] = Field(description="Id of the effect.")
    knots_s: list[Annotated[float, unit("s")]] = Field(
        [],
        description="Times between which the base goes straight on, s; empty: as many pieces as `pieces` says, with as many rows each.",
    )
    pieces: Annotated[int, Field(ge=1, le=50)] = Field(6, description="How many pieces, 1 to 50.")


class BaseStepEffect(_Whole):
    """Base or instrument moved once, between two rows."""

    id: Literal["base_step"] = Field(description="Id of the effect.")
    at_s: Annotated[float, unit("s")] | None = Field(None, description="When it happened, s on the clock of the rows.")
    at_row: int | None = Field(None, description="First row after it, counted from 1 as measured.")


class ToolStepEffect(_Whole):
    """Tool, marker or nest moved once, between two rows."""

    id: Literal["tool_step"] = Field(description="Id of the effect.")
    at_s: Annotated[float, unit("s")] | None = Field(None, description="When it happened, s on the clock of the rows.")
    at_row: int | None = Field(None, description="First row after it, counted from 1 as measured.")


class ColumnBendingEffect(_Whole):
    """Column under the arm bends with temperature."""

    id: Literal["column_bending"] = Field(description="Id of the effect.")
    reference_c: Annotated[float, unit("degC", gt=-273.15)] = Field(
        20.0, description="Temperature T0 at which the geometry holds, degrees Celsius."
    )


class ThermalDriftEffect(_Whole):
    """Motion of the base or of the instrument with temperature."""

    id: Literal["thermal_drift"] = Field(description="Id of the effect.")
    reference_c: Annotated[float, unit("degC", gt=-273.15)] = Field(
        20.0, description="Temperature T0 at which the geometry holds, degrees Celsius."
    )


class MeasuredTiltEffect(_Whole):
    """Base moves as its inclinometer reads."""

    id: Literal["measured_tilt"] = Field(description="Id of the effect.")
    zero_x_rad: Annotated[float, unit("rad")] | None = Field(
        None, description="Reading about x at which the geometry holds, rad; null: the mean of the rows."
    )
    zero_y_rad: Annotated[float, unit("rad")] | None = Field(
        None, description="Reading about y at which the geometry holds, rad; null: the mean of the rows."
    )


class ToolSagEffect(_Whole):
    """Tool or adapter sags under the payload."""

    id: Literal["tool_sag"] = Field(description="Id of the effect.")
    axis: list[float] | None = Field(
        None, description="The tool's z in the frame of the last joint, along which nothing sags; null: from the robot."
    )


class UnknownFieldEffect(_Whole):
    """Smooth error field in the workspace without a known cause."""

    id: Literal["unknown_field"] = Field(description="Id of the effect.")
    degree: Annotated[int, Field(ge=1, le=3)] = Field(2, description="Degree of the polynomial, 1 to 3.")
    reach_m: Annotated[float, unit("m", gt=0.0)] | None = Field(
        None, description="Length by which positions are scaled, m, above 0; null: from the robot."
    )


class UnknownResidualEffect(_Whole):
    """What no effect explains, learned from the joint angles."""

    id: Literal["unknown_residual"] = Field(description="Id of the effect.")
    inputs: list[JointNumber] | None = Field(None, description="Joints it depends on, from 1; null: all.")
    length: Annotated[float, Field(gt=0.0)] | None = Field(
        None,
        description="Distance over which poses are similar, rad (prismatic joints: thirds of their travel), above 0; null: half the median distance.",
    )
    amplitude_m: Annotated[float, unit("m", gt=0.0)] = Field(
        0.0003, description="Standard deviation of the shift, m, above 0."
    )
    most_centres: Annotated[int, Field(ge=1)] = Field(60, description="Most centres of the basis.")
    centres: list[list[float]] = Field(
        [],
        description="Centres of the basis, a row of joint values (rad; prismatic joints in thirds of their travel) for each; empty: from the rows.",
    )
    slides_m: list[Annotated[float, unit("m")]] = Field(
        [], description="Travel that scales each prismatic joint, m; empty: from the rows."
    )


class LoadErrorEffect(_Whole):
    """Masses and centres of links and payload not as stated, seen through the effects that follow loads."""

    id: Literal["load_error"] = Field(description="Id of the effect.")
    payload_kg: Annotated[float, unit("kg", ge=0.0)] = Field(
        0.0,
        description="Mean payload of the rows, kg, which scales the prior of its mass; 0: the payload is as stated.",
    )
    mass_share: Annotated[float, Field(ge=0.0)] = Field(
        0.0, description="Standard deviation of every mass as a share of it; 0: what the robot says of each."
    )
    centre_m: Annotated[float, unit("m", ge=0.0)] = Field(
        0.0, description="Standard deviation of each coordinate of every centre, m; 0: what the robot says of each."
    )
