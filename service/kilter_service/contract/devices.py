"""Instruments with their certificates, and cameras and boards as a fit found them."""

from __future__ import annotations

from datetime import date, datetime
from typing import Annotated, Literal

from pydantic import Field, model_validator

from kilter_service.contract.units import Deg, Listed, Micrometres, MicrometresPerMetre, Mm, Name, Stored, Strict

InstrumentKind = Literal["laser_tracker", "arm_cmm", "cmm", "camera", "ball_bar", "other"]
MpeStandard = Literal["iso_10360_10", "iso_10360_12", "other"]
Text = Annotated[str, Field(max_length=200)]
OF_KIND: dict[str, InstrumentKind] = {"iso_10360_10": "laser_tracker", "iso_10360_12": "arm_cmm"}
LARGEST_MPE_UM, LARGEST_MPE_UM_PER_M = 100_000.0, 10_000.0


class NewInstrument(Strict):
    """An instrument as one certificate describes it: with the next certificate it is added under another name.

    Its maximum permissible error for a length L is ``mpe_um + mpe_um_per_m * L``, L in metres.
    """

    name: Name = Field(
        description="Name of the instrument with this certificate, unique on the server: letters, digits, `_`, `.` and `-`."
    )
    kind: InstrumentKind = Field(description="What it is; `arm_cmm`: an articulated arm with a probe.")
    serial_number: Annotated[Text, Field(min_length=1)] = Field(description="Serial number, as on its plate.")
    mpe_standard: MpeStandard = Field(
        "other",
        description="What states its permissible error: ISO 10360-10 (laser trackers), ISO 10360-12 (articulated arms), or "
        "other, for instance its maker.",
    )
    mpe_um: Annotated[Micrometres, Field(ge=0, le=LARGEST_MPE_UM)] = Field(
        description="Maximum permissible error at length 0, micrometres: A of A + B L."
    )
    mpe_um_per_m: Annotated[MicrometresPerMetre, Field(ge=0, le=LARGEST_MPE_UM_PER_M)] = Field(
        0.0, description="What it grows by per length, micrometres per metre: B of A + B L."
    )
    certificate: Text = Field("", description="Number of its calibration certificate; empty: none.")
    certified_on: date | None = Field(None, description="Day of the certificate; null: not stated.")
    valid_until: date | None = Field(None, description="Last day on which it holds; null: not stated.")
    notes: Annotated[str, Field(max_length=20_000)] = Field("", description="Whatever else is worth knowing.")

    @model_validator(mode="after")
    def _fits_together(self) -> NewInstrument:
        if self.mpe_um == 0.0 and self.mpe_um_per_m == 0.0:
            raise ValueError("no instrument is without error: give mpe_um, mpe_um_per_m or both")
        if self.certified_on and self.valid_until and self.valid_until < self.certified_on:
            raise ValueError("valid_until is before certified_on")
        if OF_KIND.get(self.mpe_standard, self.kind) != self.kind:
            raise ValueError(
                f"mpe_standard {self.mpe_standard} is of kind {OF_KIND[self.mpe_standard]}, not {self.kind}: give `other`"
            )
        return self


class Instrument(NewInstrument):
    """A stored instrument."""

    created_at: datetime = Field(description="When it was added.")


class InstrumentList(Listed):
    """All instruments, by name."""

    instruments: list[Instrument] = Field(description="Instruments, by name.")


class _Placed(Stored):
    """Where something of a measurement stands."""

    name: str = Field(description="Its name.")
    mount: str = Field(description="`fixed` in the room, or on the `flange`.")
    frame: str = Field(description="Frame of the numbers: the robot's `base`, or its `flange`.")
    x_mm: Mm = Field(description="Place along x, mm.")
    y_mm: Mm = Field(description="Place along y, mm.")
    z_mm: Mm = Field(description="Place along z, mm.")
    rx_deg: Deg = Field(description="Roll, degrees (URDF).")
    ry_deg: Deg = Field(description="Pitch, degrees.")
    rz_deg: Deg = Field(description="Yaw, degrees.")
    sigma_mm: tuple[Mm, Mm, Mm] | None = Field(
        None, description="Standard deviations of the place along its own axes, mm; null: not known."
    )
    sigma_deg: tuple[Deg, Deg, Deg] | None = Field(
        None, description="Standard deviations of rotations about its own axes, degrees; null: not known."
    )


class CameraFound(_Placed):
    """A camera as a fit found it; z of its frame looks ahead, x to the right and y down."""

    width_px: int = Field(description="Width of its pictures, px.")
    height_px: int = Field(description="Height of its pictures, px.")
    fx_px: float = Field(description="Focal length along u, px.")
    fy_px: float = Field(description="Focal length along v, px.")
    cx_px: float = Field(description="Principal point along u, px.")
    cy_px: float = Field(description="Principal point along v, px.")
    distortion_model: str = Field(description="Model of the lens.")
    distortion: list[float] = Field(description="Numbers of the lens, in OpenCV's order.")
    intrinsics_sigmas: list[float] | None = Field(
        None, description="Standard deviations of fx, fy, cx, cy (px) and of the lens, 0 where held; null: not known."
    )


class BoardFound(_Placed):
    """A board as a fit found it."""

    scale_percent: float = Field(description="By how much it is larger than described, percent.")
    scale_sigma_percent: float | None = Field(None, description="Standard deviation of that, percent; null: held.")


class ToolScatter(Stored):
    """How far off the tool is in views, the noise of the views taken off."""

    rms_mm: Mm = Field(description="Root mean square distance, mm.")
    low_mm: Mm = Field(description="Lower end of its 95 % interval, mm.")
    high_mm: Mm = Field(description="Upper end, mm.")
    orientation_deg: Deg = Field(description="Root mean square angle, degrees.")


class LeftOpen(Stored):
    """How far off the tool may be by what a fit to views leaves open, with base and tool where they fit best."""

    rms_mm: Mm = Field(description="Root mean square distance that is expected, mm.")
    high_mm: Mm = Field(description="Upper end of its 95 % interval, mm.")


class PixelsFound(Stored):
    """What pixels alone say of their own noise and of the tool."""

    noise_px: float = Field(description="Standard deviation of a corner, px, from within views: no model enters.")
    between_views: float = Field(
        description="Variance between views over what their corners explain: 1 where the model lacks nothing."
    )
    train: ToolScatter = Field(description="The tool in the views that were fitted.")
    validation: ToolScatter | None = Field(None, description="The tool in views held out; null: none, or folds.")
    left_open: LeftOpen | None = Field(
        None,
        description="How far off the tool may be by what the fit leaves open, most of it along the lines of sight and in how "
        "large everything is: views hardly see that, held out or not. Null: not known.",
    )
    given_mm: Mm | None = Field(
        None,
        description="What hand-eye of the arm as it began leaves in the views that were fitted, mm: median, a rotation "
        "counted 0.3 m off; null: too few views.",
    )
    shuffled_mm: Mm | None = Field(
        None, description="The same with joints that belong to other views, mm: the negative control."
    )
