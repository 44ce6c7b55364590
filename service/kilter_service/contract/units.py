"""What all models of the contract share: strictness, numbers with their unit, and how large a thing may be."""

from __future__ import annotations

from typing import Annotated, Any, Literal, cast

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

# A serial arm; what a server may change is in its settings, what guards the reading of files in `kilter_service.ground.limits`.
MAX_JOINTS = 32
MAX_ELEMENTS = 512
MAX_NAMED = 1000  # campaigns that one job names


def unit(symbol: str, **limits: Any) -> Any:
    """Say the unit of a number in the OpenAPI document, as `x-unit`, and what it may be."""
    return Field(json_schema_extra={"x-unit": symbol}, **limits)


Mm = Annotated[float, unit("mm")]
Micrometres = Annotated[float, unit("um")]
MicrometresPerMetre = Annotated[float, unit("um/m")]
Metres = Annotated[float, unit("m")]
Deg = Annotated[float, unit("deg")]
Rad = Annotated[float, unit("rad")]
Kg = Annotated[float, unit("kg")]
Newton = Annotated[float, unit("N")]
NewtonMetre = Annotated[float, unit("N m")]
Celsius = Annotated[float, unit("degC", gt=-273.15)]
Seconds = Annotated[float, unit("s")]
Percent = Annotated[float, unit("%")]
MPerS2 = Annotated[float, unit("m/s2")]
KgM2 = Annotated[float, unit("kg m2")]
Load = Annotated[float, unit("kg", ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Fraction = Annotated[float, Field(ge=0, lt=1)]
Direction = tuple[float, float, float]
PointMm = tuple[Mm, Mm, Mm]
JointNumber = Annotated[int, Field(ge=1, le=MAX_JOINTS)]
JointType = Literal["revolute", "prismatic"]
Drive = Literal["linkage", "controller", "series"]
DRIVE = (
    "Who carries the load on an axis that follows a joint (mimic, parallelogram): `linkage`: the gear of that joint too, by "
    "virtual work (rods); `controller`: only the motor of its own, which the controller moves along; `series`: gears of "
    "its own in series; null: nobody said, and the joint does not carry it."
)
ControllerCompensation = Literal["none", "factory", "kilter", "unknown"]
COMPENSATION = (
    "Whether the controller corrects the arm by itself: `none`; `factory`: by its maker's calibration; `kilter`: by a "
    "calibration that Kilter exported; `unknown`: nobody said."
)
ToleranceMm = Annotated[float, unit("mm", gt=0, le=1000)]
IntervalDays = Annotated[int, Field(ge=1, le=3650)]
TOLERANCE = "Largest mean error of the tool that is good enough, mm."
INTERVAL = "Whole days within which the robot is to be checked."

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Id = Annotated[str, Field(max_length=64)]
Ids = Annotated[list[Id], Field(max_length=MAX_NAMED)]


class Strict(BaseModel):
    """No unknown field, no silent conversion of text to numbers, finite numbers only."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Written(BaseModel):
    """Shows what was written and leaves out the rest, because a default would say more than anybody has."""

    @model_serializer(mode="wrap")
    def _as_it_was_written(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields = type(self).model_fields
        told = {name if name not in fields else fields[name].alias or name for name in self.model_fields_set}
        return {name: value for name, value in handler(self).items() if name in told}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe the fields; the serializer's own schema would only say that this is an object."""
        return handler(cast(CoreSchema, {key: part for key, part in schema.items() if key != "serialization"}))


class Stored(_Written):
    """A part of an answer that was written when its job ran, maybe by an earlier release: it is never refused."""

    model_config = ConfigDict(extra="ignore")


class Asked(_Written):
    """Options as they are asked for: nothing unknown, no text for a number, and shown again as they came."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class Listed(Strict):
    """A page of a list."""

    next: str | None = Field(None, description="Give it as `after` for the page that follows; null: this is the last.")


class Pose(Strict):
    """A frame: position, then Rz Ry Rx (the convention of URDF)."""

    x_mm: Mm = Field(0.0, description="Position along x, mm.")
    y_mm: Mm = Field(0.0, description="Position along y, mm.")
    z_mm: Mm = Field(0.0, description="Position along z, mm.")
    rx_deg: Deg = Field(0.0, description="Rotation about x, degrees: the first of Rz Ry Rx to act.")
    ry_deg: Deg = Field(0.0, description="Rotation about y, degrees.")
    rz_deg: Deg = Field(0.0, description="Rotation about z, degrees: the last to act.")
