"""Rows of the complete models: product of exponentials, CPC, MCPC and the S-model."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat

from service.contract.units import JointType, Strict, Vector


class PoeAxis(Strict):
    """A moving axis at zero, in the base frame; the joint that drives it, times ratio (default: the next joint)."""

    direction: Vector
    point_mm: Vector = (0.0, 0.0, 0.0)
    type: JointType = "revolute"
    joint: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    ratio: FiniteFloat = 1.0


class CpcRow(Strict):
    """Direction of the next axis in the frame before, and its shift; then the joint."""

    b: Vector
    x_mm: FiniteFloat = 0.0
    y_mm: FiniteFloat = 0.0
    theta_offset_deg: FiniteFloat = 0.0
    type: JointType = "revolute"


class CpcFlange(Strict):
    """R(b) Rz(beta) Tx Ty Tz after the last joint."""

    b: Vector = (0.0, 0.0, 1.0)
    beta_deg: FiniteFloat = 0.0
    x_mm: FiniteFloat = 0.0
    y_mm: FiniteFloat = 0.0
    z_mm: FiniteFloat = 0.0


class McpcRow(Strict):
    """Rx(alpha) Ry(beta) Tx(x) Ty(y), then the joint."""

    alpha_deg: FiniteFloat = 0.0
    beta_deg: FiniteFloat = 0.0
    x_mm: FiniteFloat = 0.0
    y_mm: FiniteFloat = 0.0
    theta_offset_deg: FiniteFloat = 0.0
    type: JointType = "revolute"


class McpcFlange(Strict):
    """Rx(alpha) Ry(beta) Rz(gamma) Tx Ty Tz after the last joint."""

    alpha_deg: FiniteFloat = 0.0
    beta_deg: FiniteFloat = 0.0
    gamma_deg: FiniteFloat = 0.0
    x_mm: FiniteFloat = 0.0
    y_mm: FiniteFloat = 0.0
    z_mm: FiniteFloat = 0.0


class SModelRow(Strict):
    """Tz(d) Rz(theta) Tx(a) Rx(alpha) Rz(gamma) Tz(b)."""

    theta_offset_deg: FiniteFloat = 0.0
    d_mm: FiniteFloat = 0.0
    a_mm: FiniteFloat = 0.0
    alpha_deg: FiniteFloat = 0.0
    gamma_deg: FiniteFloat = 0.0
    b_mm: FiniteFloat = 0.0
    type: JointType = "revolute"
