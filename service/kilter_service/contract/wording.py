"""References and names, warnings, words of comparisons and errors, and documents that were written long ago."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Mapping, Sequence
from datetime import datetime
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, cast

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from kilter_service.contract.fits import Errors
from kilter_service.contract.units import (
    COMPENSATION,
    INTERVAL,
    TOLERANCE,
    ControllerCompensation,
    Deg,
    IntervalDays,
    Listed,
    Mm,
    Stored,
    Strict,
    ToleranceMm,
)

SMALLEST = 1e-6  # of probabilities that anybody tells apart


def unit_of_length(length_mm: float) -> tuple[str, float]:
    """The unit in which people read a length, and how many there are in a millimetre."""
    return ("µm", 1e3) if abs(length_mm) < 0.1 else ("mm", 1.0)


def said_of_lengths(largest_mm: float, *lengths_mm: float) -> list[str]:
    """Write lengths in the unit of the largest, as finely as three digits of it."""
    unit, scale = unit_of_length(largest_mm)
    digits = max(DIGITS - 1 - math.floor(math.log10(scale * abs(largest_mm))), 0) if largest_mm else 0
    return [f"{round(scale * one, digits) + 0.0:.{digits}f} {unit}" for one in lengths_mm]


def said_of_chance(value: float) -> str:
    """Write a probability: as a number where people read it so, as a power of ten where it is tiny."""
    if value < SMALLEST:
        return f"below {SMALLEST:.0e}".replace("e-0", "e-")
    return f"{value:.0e}".replace("e-0", "e-") if value < 1e-3 else f"{value:.2g}"


DIGITS = 3  # of a mean error in a sentence
QUANTILE = 1.96  # of the standard normal at 97.5 %


def interval(found: Errors, n: int | None) -> tuple[float, float] | None:
    """Return the 95 % interval of a mean error over ``n`` points, mm; None where the spread is not known."""
    if not n or n < 2 or found.rms_mm is None:
        return None
    variance = max(found.rms_mm**2 - found.mean_mm**2, 0.0) * n / (n - 1)
    half = QUANTILE * math.sqrt(variance / n)
    return max(found.mean_mm - half, 0.0), found.mean_mm + half


def widest(found: Errors, n: int | None) -> float:
    """Return the largest of a mean error, the ends of its interval and its 95 % quantile, mm: its unit is that of all."""
    beside = (found.mean_mm, found.p95_mm, *(interval(found, n) or ()))
    return float(max(one for one in beside if one is not None))


def said_of_error(value_mm: float, largest_mm: float) -> str:
    """Write an error in the unit of the largest, with three digits of its own."""
    unit, scale = unit_of_length(largest_mm)
    scaled = scale * value_mm
    if not scaled or not math.isfinite(scaled):
        return f"{scaled:g} {unit}"
    decimals = max(DIGITS - 1 - math.floor(math.log10(abs(scaled))), 0)
    return f"{round(scaled, decimals):.{decimals}f} {unit}"


SYMBOLS = {"um": "micrometres", "degC": "°C"}
PLAIN = {"boolean": "true or false", "string": "text", "object": "an object"}


def describe_schema(schema: Mapping[str, Any] | None) -> str:
    """Say what a schema allows besides null; empty when there is nothing short to say."""
    if schema is None:
        return ""
    parts = [part for part in schema.get("anyOf", [schema]) if part.get("type") != "null"]
    said = [_describe_schema_part(part) for part in parts]
    return " or ".join(one for one in said if one)


def _describe_schema_part(part: Mapping[str, Any]) -> str:
    if "enum" in part or "const" in part:
        values = [str(value) for value in part.get("enum", [part.get("const")])]
        return values[0] if len(values) == 1 else f"{', '.join(values[:-1])} or {values[-1]}"
    sort = part.get("type")
    if sort in ("integer", "number"):
        return f"a {'whole number' if sort == 'integer' else 'number'}{_range(part)}"
    if sort == "array":
        inner = describe_schema(part.get("items"))
        return f"a list of {inner}" if inner else "a list"
    return PLAIN.get(str(sort), "")


def _range(part: Mapping[str, Any]) -> str:
    low, above = part.get("minimum"), part.get("exclusiveMinimum")
    high, below = part.get("maximum"), part.get("exclusiveMaximum")
    symbol = part.get("x-unit", "")
    unit = f" {SYMBOLS.get(symbol, symbol)}" if symbol else ""
    if low is not None and high is not None:
        return f" from {low:.10g} to {high:.10g}{unit}"
    if above is not None and below is not None:
        return f" between {above:.10g} and {below:.10g}{unit}"
    if above is not None:
        return f" above {above:.10g}{unit}"
    if low is not None:
        return f" of 0 or more{unit}" if low == 0 else f" of at least {low:.10g}{unit}"
    return f" in {unit.strip()}" if unit else ""


class OddMass(Stored):
    """A mass or a centre far from what was stated."""

    link: int | None = Field(None, description="Number of the link, from 1; null: the payload.")
    parameter: str | None = Field(None, description="`mass`, or a coordinate of the centre such as `com_x`.")
    unit: str | None = Field(None, description="kg or mm.")
    stated: float | None = Field(None, description="What was stated.")
    value: float | None = Field(None, description="What the data say.")


class Remark(Stored):
    """A warning: ``code`` is for programs, ``message`` says what is the matter and what helps. The rest goes with the code."""

    code: str = Field(description="Stable name of the warning.")
    message: str = Field(description="What is the matter, and what helps.")
    joint: str | None = Field(None, description="Name of the joint it is about.")
    effects: list[str] | None = Field(None, description="Ids of the effects it is about.")
    campaigns: list[str] | None = Field(None, description="Ids of the campaigns it is about.")
    markers: list[int] | None = Field(None, description="Numbers of the markers it is about, from 1.")
    rows: list[int] | None = Field(None, description="Rows it is about, from 1.")
    off_mm: list[Mm] | None = Field(None, description="How far each of these rows is off, mm.")
    others_mm: Mm | None = Field(
        None, description="How far the other rows are off at most, but for a quarter of them, mm."
    )
    sigmas: list[float] | None = Field(
        None, description="The same of its worst coordinate, in standard deviations of what was expected there."
    )
    row: int | None = Field(None, description="The row it is about, from 0.")
    visits: int | None = Field(None, description="How many visits it is about.")
    masses: list[OddMass] | None = Field(None, description="Masses and centres far from what was stated.")
    ratio: float | None = Field(None, description="What is left, in multiples of the noise.")
    axis: str | None = Field(None, description="Axis it is about, such as `z` or `-x`.")
    angle_deg: Deg | None = Field(None, description="Angle it is about, degrees.")
    here_mm: Mm | None = Field(None, description="Uncertainty of the tool in the measured poses, mm.")
    elsewhere_mm: Mm | None = Field(None, description="Uncertainty of the tool over the joint limits, mm.")
    simpler_mm: Mm | None = Field(None, description="Error of the simpler model on held-out rows, mm.")
    identified_mm: Mm | None = Field(None, description="Error of the identified model on held-out rows, mm.")
    left_out: list[str] | None = Field(None, description="What there was no time for.")
    budget_s: float | None = Field(None, description="Time that was given, s.")
    quantity: str | None = Field(None, description="Which errors were compared: `mean by pose` or `rms by pose`.")
    simpler_deg: Deg | None = Field(None, description="Error of the simpler model on held-out rows, degrees.")
    identified_deg: Deg | None = Field(None, description="Error of the identified model on held-out rows, degrees.")
    beyond_chance: bool | None = Field(None, description="Whether the difference is more than chance explains.")


T = TypeVar("T")

MOST_REPAIRS = 100


@cache
def _adapter(kind: Hashable) -> TypeAdapter[Any]:
    return TypeAdapter(cast(Any, kind))


def as_written(kind: type[T], document: object) -> T:
    """Read a stored document as ``kind``.

    Raises:
        ValidationError: nothing of it can be read.

    """
    adapter: TypeAdapter[T] = _adapter(cast(Hashable, kind))
    try:
        return adapter.validate_python(document)
    except ValidationError as error:
        rest, found = copy.deepcopy(document), error
    for _ in range(MOST_REPAIRS):
        taken = [_leave_out(rest, one["loc"]) for one in reversed(found.errors(include_url=False))]
        if not any(taken):
            break
        try:
            return adapter.validate_python(rest)
        except ValidationError as error:
            found = error
    raise found


def _leave_out(document: Any, place: Sequence[str | int]) -> bool:
    """Take out what is at a place, or what lacks something there; returns whether there was anything to take out."""
    path: list[tuple[Any, Any]] = []
    node = document
    for key in place:
        inside = (
            isinstance(key, int) and key < len(node)
            if isinstance(node, list)
            else isinstance(node, dict) and key in node
        )
        if not inside:
            break
        path.append((node, key))
        node = node[key]
    if not path:
        return False
    owner, last = path[-1]
    del owner[last]
    return True


Kind = Literal["campaign", "version", "job"]
By = Literal["id", "prefix", "name", "latest", "number"]
Title = Annotated[str, Field(max_length=200)]
Notes = Annotated[str, Field(max_length=20_000)]
TITLE = "What people call it, at most 200 characters; unique for its robot while it is in use."
NOTES = "What people noted on it, at most 20000 characters."
RETIRED_AT = "Since when it is out of use; null: it is in use."


class ResolvedReference(Strict):
    """What a prefix, a name or `latest` stands for."""

    kind: Kind = Field(description="What it is.")
    id: str = Field(description="Its full id.")
    robot: str = Field(description="Name of the robot it belongs to.")
    name: str = Field(description="What people call it; empty: it has no name.")
    by: By = Field(description="How it was found: what the reference was.")
    number: int = Field(0, description="Which version of its robot it is, from 1; 0: not a version.")


class Change(Strict):
    """What people call a campaign or a version, and note on it; what is left out stays."""

    name: Title | None = Field(None, description=TITLE)
    notes: Notes | None = Field(None, description=NOTES)


class RobotChange(Strict):
    """What people say of a robot; what is left out stays, and so does its name, which is its address."""

    remarks: Notes | None = Field(None, description="What people noted on the robot, at most 20000 characters.")
    controller_compensation: ControllerCompensation | None = Field(None, description=COMPENSATION)
    tolerance_mm: ToleranceMm | None = Field(None, description=f"{TOLERANCE} Null: none.")
    check_interval_days: IntervalDays | None = Field(None, description=f"{INTERVAL} Null: none.")

    @model_validator(mode="after")
    def _something(self) -> RobotChange:
        if not self.model_fields_set:
            raise ValueError("give remarks, controller_compensation, tolerance_mm or check_interval_days")
        return self


class Tombstone(Strict):
    """What is left of something that was purged."""

    id: str = Field(description="The id it had; a robot's is its name.")
    kind: Literal["campaign", "version", "robot"] = Field(description="What it was.")
    robot: str = Field(description="Name of the robot it belonged to.")
    name: str = Field(description="What it was called.")
    sha256: str = Field(
        description="Of a version its hash, of a robot that of its chain, of a campaign that of its uploads' hashes."
    )
    by: str = Field(description="Who purged it.")
    at: datetime = Field(description="When it was purged.")


class TombstoneList(Listed):
    """What was purged, newest first."""

    tombstones: list[Tombstone] = Field(description="What was purged, newest first.")
