"""Campaigns and uploads."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, Field, WithJsonSchema
from pydantic_core import PydanticCustomError

from kilter_service.contract.units import Celsius, Listed, Load, Mm, Name, Newton, NewtonMetre, PointMm, Strict
from kilter_service.contract.wording import RETIRED_AT, Remark

SaidBy = Literal["rows", "identification", "search"]


class SuspiciousRow(Strict):
    """A row that looks wrong, as one of those who say so sees it."""

    row: int = Field(description="Row of the campaign, from 1.")
    file: int = Field(description="The file of the campaign that it is in, from 1.")
    file_row: int = Field(description="Its row in that file, from 1.")
    said_by: SaidBy = Field(
        description="`rows`: the rows themselves, before any fit; `identification`, `search`: the job that made a version."
    )
    version_id: str | None = Field(description="The version of that job; null: no job says it.")
    version_name: str = Field(description="Its name; empty: it has none.")
    job_id: str | None = Field(description="The job.")
    mm: Mm | None = Field(description="How far the row is from where it should be, mm; null: not known as a length.")
    sigma: float | None = Field(description="The same in standard deviations; null: not known.")
    weight: float | None = Field(
        description="What it counts in that fit, 0 to 1; null: nothing was fitted, and the row counts."
    )
    held_out: bool = Field(description="Whether the job held it out, and left it out of the errors on held-out rows.")
    why: str = Field(description="What looks wrong, in words.")


class SuspiciousRows(Strict):
    """All rows of a campaign that look wrong, by row; a row may be named by several."""

    campaign: str = Field(description="Id of the campaign.")
    name: str = Field(description="Its name.")
    rows: int = Field(description="Rows of the campaign.")
    count: int = Field(description="How many of them look wrong to somebody.")
    found: list[SuspiciousRow] = Field(
        description="What is said of them, by row, at most 2000 entries: the rest is counted."
    )
    sentence: str = Field(description="The same in words.")


Role = Literal["train", "validation", "confirmation"]
Text = Annotated[str, Field(max_length=200)]
ODD = "What looks odd in the rows and may be right: they are stored."
SHA256 = "SHA-256 of the bytes that were sent, 64 hexadecimal digits."
HASH = "^[0-9a-f]{64}$"


def _enough_corners(corners: Any) -> Any:
    if isinstance(corners, list) and len(corners) < FEWEST_CORNERS:
        raise PydanticCustomError(
            "too_short",
            "Has fewer than four corners: a view of a board tells a pose, and of a single mark it does not. Describe four "
            "corners or more that are not on one line; of a mark that two cameras see send the place (x_mm, y_mm, z_mm).",
        )
    return corners


def _hash_of_servos(text: str) -> str:
    if re.fullmatch(HASH[1:-1], text) is None:
        raise PydanticCustomError(
            "string_pattern_mismatch",
            "Is not the SHA-256 of a file: 64 of the digits 0 to 9 and a to f, letters small. Give what "
            "`sha256sum my_arm.json` prints first, or null where it is unknown; "
            "`kilter upload --calibration my_arm.json` states it by itself.",
        )
    return text


# Says what to send where a pattern would only be repeated.
HashOfServos = Annotated[str, AfterValidator(_hash_of_servos), WithJsonSchema({"type": "string", "pattern": HASH})]


MOST_CAMERAS, FEWEST_CORNERS, MOST_CORNERS = 64, 4, 999


class Camera(Strict):
    """A camera that measured; where it stands is fitted."""

    name: Name = Field(description="Its name; one name stands for one camera in one place.")
    mount: Literal["fixed", "flange"] = Field(
        description="`fixed`: in the room, it looks at boards on the flange; `flange`: it looks at fixed boards."
    )
    width_px: Annotated[int, Field(ge=1, le=100_000)] = Field(description="Width of its pictures, px.")
    height_px: Annotated[int, Field(ge=1, le=100_000)] = Field(description="Height of its pictures, px.")
    fx_px: Annotated[float, Field(gt=0)] = Field(description="Focal length along u, px.")
    fy_px: Annotated[float, Field(gt=0)] = Field(description="Focal length along v, px.")
    cx_px: float = Field(description="Principal point along u, px; the centre of the top left pixel is 0.")
    cy_px: float = Field(description="Principal point along v, px.")
    distortion_model: Literal["none", "brown", "rational", "fisheye"] = Field("none", description="Model of the lens.")
    distortion: Annotated[list[float], Field(max_length=8)] = Field(
        [],
        description="Numbers of the lens in OpenCV's order: k1, k2, p1, p2 (k3) (k4, k5, k6), of a fisheye k1 to k4.",
    )
    intrinsics: Literal["fixed", "prior", "free"] | None = Field(
        None, description="Whether a fit changes them; null: `prior` where `sigmas_px` are given, else `fixed`."
    )
    sigmas_px: Annotated[list[Annotated[float, Field(gt=0)]], Field(max_length=12)] | None = Field(
        None,
        description="Standard deviations of fx, fy, cx, cy (px) and of each number of the lens, above 0; null: not stated.",
    )


class Board(Strict):
    """A board, or a solid of several, whose corners were seen."""

    name: Name = Field(description="Its name; one name stands for one board in one place.")
    mount: Literal["flange", "fixed"] = Field(description="Whether it is on the flange, or in the room.")
    corners_mm: Annotated[
        list[PointMm], BeforeValidator(_enough_corners), Field(min_length=FEWEST_CORNERS, max_length=MOST_CORNERS)
    ] = Field(description="Corners 1, 2, ... in a frame of its own, mm.")
    scale_sigma_percent: Annotated[float, Field(ge=0, le=10)] | None = Field(
        None, description="Standard deviation of its scale, percent: it is then fitted; null: the scale is exact."
    )


class Conditions(Strict):
    """What held during the whole campaign; a column of the rows takes precedence over it."""

    payload_kg: Load | None = Field(None, description="Mass at the tool point, kg, 0 or more; null: not known.")
    payload_com_mm: PointMm | None = Field(
        None, description="Centre of the payload in the tool frame, mm; null: the tool point."
    )
    temperature_c: Celsius | None = Field(None, description="Temperature of the arm, degrees Celsius.")
    tool_force_n: tuple[Newton, Newton, Newton] | None = Field(
        None, description="Force on the tool point in the tool frame, N."
    )
    tool_moment_nm: tuple[NewtonMetre, NewtonMetre, NewtonMetre] | None = Field(
        None, description="Moment on the tool point in the tool frame, N m."
    )
    calibration_sha256: HashOfServos | None = Field(
        None,
        description="SHA-256 of the file with the zeros of the arm's servos (LeRobot's calibration), 64 hexadecimal digits: "
        "all campaigns of a robot have the same; null: not stated.",
    )
    cameras: Annotated[list[Camera], Field(min_length=1, max_length=MOST_CAMERAS)] | None = Field(
        None, description="Cameras whose pixels the rows have, in the order of their numbers; null: none."
    )
    boards: Annotated[list[Board], Field(min_length=1, max_length=MOST_CAMERAS)] | None = Field(
        None, description="Boards that the cameras saw, in the order of their numbers; null: none."
    )
    unchecked: Literal[True] | None = Field(
        None,
        description="The rows are right, whatever they look like: upload and jobs warn where they would refuse; null: no.",
    )


class _Campaign(Strict):
    name: Annotated[Text, Field(min_length=1)] = Field(description="Name for people, at most 200 characters.")
    device: Text = Field(
        "",
        description="What it was measured with; `pencil`, `sheet` and `ballbar` have a frame of their own every time.",
    )
    role: Role = Field("train", description="What it is meant for; a job may use it otherwise.")
    conditions: Conditions = Field(Conditions(), description="What held during the whole campaign.")
    notes: Annotated[str, Field(max_length=20_000)] = Field("", description="Whatever else is worth knowing.")
    measured_at: AwareDatetime | None = Field(
        None, description="When its last row was measured, with the time zone; null: not stated."
    )
    instrument: Name | None = Field(
        None,
        description="Name of the instrument it was measured with, as stored (`/v1/instruments`); null: not stated.",
    )
    staged: bool = Field(
        False, description="Whether its parts come one by one, and it is hidden until they are all there."
    )


class NewCampaign(_Campaign):
    """A campaign to measure."""

    numbered: bool = Field(
        False, description="Whether a number is put behind the name when another campaign in use has it."
    )


class StoredFile(Strict):
    """A file of observations."""

    sha256: str = Field(description=SHA256)
    rows: int = Field(description="Rows of the file.")
    columns: list[str] = Field(description="Columns of the file, in its order.")


class Upload(StoredFile):
    """A stored file of observations."""

    media_type: str = Field(description="Media type it was sent as.")
    created_at: datetime = Field(description="When it was stored.")


class Campaign(_Campaign):
    """A campaign and what was uploaded to it."""

    id: str = Field(description="Id of the campaign, `cmp_` and 16 hexadecimal digits.")
    robot: str = Field(description="Name of its robot.")
    created_at: datetime = Field(description="When it was added.")
    retired_at: datetime | None = Field(None, description=RETIRED_AT)
    rows: int = Field(description="Rows of all its uploads.")
    uploads: list[Upload] = Field(description="Files stored, oldest first.")
    warnings: list[Remark] = Field([], description="What the instrument's certificate has against it.")


class Parts(Strict):
    """The content hashes of all parts of a staged campaign."""

    sha256: Annotated[list[Annotated[str, Field(pattern=HASH)]], Field(min_length=1, max_length=100_000)] = Field(
        description="SHA-256 of each part, 64 hexadecimal digits."
    )


class CampaignList(Listed):
    """The campaigns of a robot, oldest first."""

    campaigns: list[Campaign] = Field(description="Campaigns, oldest first.")


class Uploaded(StoredFile):
    """What an upload became; ``new`` is false when the same bytes were there already."""

    campaign_id: str = Field(description="Campaign it went to.")
    total_rows: int = Field(description="Rows the campaign has now.")
    new: bool = Field(description="False when the same bytes were there already.")
    warnings: list[Remark] = Field([], description=ODD)


class CheckedRows(Strict):
    """What an upload to a robot would take; nothing was stored."""

    rows: int = Field(description="Rows of the file.")
    columns: list[str] = Field(description="Columns of the file, in its order.")
    warnings: list[Remark] = Field([], description=ODD)
