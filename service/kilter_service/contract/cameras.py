"""Cameras and boards as a fit found them, and what their pixels say."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Deg, Mm, Stored


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
