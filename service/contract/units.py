"""What all models of the contract share: no unknown field, numbers with their unit, and how large a thing may be."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

# A serial arm; what a server may change is in its settings, what guards the reading of files in `service.limits`.
MAX_JOINTS = 32
MAX_ELEMENTS = 512
MAX_NAMED = 1000  # campaigns that one job names

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
JointType = Literal["revolute", "prismatic"]
Fraction = Annotated[float, Field(ge=0, lt=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Id = Annotated[str, Field(max_length=64)]
Ids = Annotated[list[Id], Field(max_length=MAX_NAMED)]


class Strict(BaseModel):
    """No unknown field, no silent conversion of text to numbers."""

    model_config = ConfigDict(extra="forbid")


class Pose(Strict):
    """A frame: position, then Rz Ry Rx (the convention of URDF)."""

    x_mm: FiniteFloat = 0.0
    y_mm: FiniteFloat = 0.0
    z_mm: FiniteFloat = 0.0
    rx_deg: FiniteFloat = 0.0
    ry_deg: FiniteFloat = 0.0
    rz_deg: FiniteFloat = 0.0
