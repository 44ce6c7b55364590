"""Rows of the complete models: product of exponentials, CPC, MCPC and the S-model."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kilter_service.contract.units import DRIVE, Deg, Direction, Drive, JointType, Mm, PointMm, Strict

TYPE = "Whether the joint is revolute or prismatic."
ZERO = "Added to the joint reading, degrees; mm for a prismatic joint."


class PoeAxis(Strict):
    """A moving axis at zero, in the base frame; the joint that drives it, times ratio (default: the next joint)."""

    direction: Direction = Field(
        description="Direction of the axis with all joints at zero; its length does not matter."
    )
    point_mm: PointMm = Field((0.0, 0.0, 0.0), description="A point on the axis with all joints at zero, mm.")
    type: JointType = Field("revolute", description=TYPE)
    joint: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        None, description="Name of the joint that drives the axis; null: the next joint."
    )
    ratio: float = Field(1.0, description="Motion of the axis per motion of the joint, no unit.")
    drive: Drive | None = Field(None, description=DRIVE)


class CpcRow(Strict):
    """Direction of the next axis in the frame before, and its shift; then the joint."""

    b: Direction = Field(description="Direction of the axis in the frame before, a vector of any length.")
    x_mm: Mm = Field(0.0, description="Shift of the axis along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift of the axis along y, mm.")
    theta_offset_deg: Deg = Field(0.0, description=ZERO)
    type: JointType = Field("revolute", description=TYPE)


class CpcFlange(Strict):
    """R(b) Rz(beta) Tx Ty Tz after the last joint."""

    b: Direction = Field((0.0, 0.0, 1.0), description="Direction of the flange's z axis in the last joint's frame.")
    beta_deg: Deg = Field(0.0, description="Rotation about that direction, degrees.")
    x_mm: Mm = Field(0.0, description="Shift along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift along y, mm.")
    z_mm: Mm = Field(0.0, description="Shift along z, mm.")


class McpcRow(Strict):
    """Rx(alpha) Ry(beta) Tx(x) Ty(y), then the joint."""

    alpha_deg: Deg = Field(0.0, description="Rotation about x, degrees.")
    beta_deg: Deg = Field(0.0, description="Rotation about y, degrees.")
    x_mm: Mm = Field(0.0, description="Shift along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift along y, mm.")
    theta_offset_deg: Deg = Field(0.0, description=ZERO)
    type: JointType = Field("revolute", description=TYPE)


class McpcFlange(Strict):
    """Rx(alpha) Ry(beta) Rz(gamma) Tx Ty Tz after the last joint."""

    alpha_deg: Deg = Field(0.0, description="Rotation about x, degrees.")
    beta_deg: Deg = Field(0.0, description="Rotation about y, degrees.")
    gamma_deg: Deg = Field(0.0, description="Rotation about z, degrees.")
    x_mm: Mm = Field(0.0, description="Shift along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift along y, mm.")
    z_mm: Mm = Field(0.0, description="Shift along z, mm.")


class SModelRow(Strict):
    """Tz(d) Rz(theta) Tx(a) Rx(alpha) Rz(gamma) Tz(b)."""

    theta_offset_deg: Deg = Field(0.0, description=ZERO)
    d_mm: Mm = Field(0.0, description="Shift along the joint's axis, mm.")
    a_mm: Mm = Field(0.0, description="Length of the link, mm.")
    alpha_deg: Deg = Field(0.0, description="Twist of the link, degrees.")
    gamma_deg: Deg = Field(0.0, description="Rotation of the link's frame about the next axis, degrees.")
    b_mm: Mm = Field(0.0, description="Shift of the link's frame along the next axis, mm.")
    type: JointType = Field("revolute", description=TYPE)
