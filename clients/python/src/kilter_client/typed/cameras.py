"""What the server answers about cameras, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record


class AnyFound(Record):
    """What a fit found of a camera or of a board."""

    frame: str
    """Frame of the numbers: the robot's `base`, or its `flange`."""
    mount: str
    """`fixed` in the room, or on the `flange`."""
    name: str
    """Its name."""
    rx_deg: float
    """Roll, degrees (URDF)."""
    ry_deg: float
    """Pitch, degrees."""
    rz_deg: float
    """Yaw, degrees."""
    sigma_deg: tuple[float, ...]
    """Standard deviations of rotations about its own axes, degrees; None: not known."""
    sigma_mm: tuple[float, ...]
    """Standard deviations of the place along its own axes, mm; None: not known."""
    x_mm: float
    """Place along x, mm."""
    y_mm: float
    """Place along y, mm."""
    z_mm: float
    """Place along z, mm."""


class CameraFound(AnyFound):
    """A camera as a fit found it; z of its frame looks ahead, x to the right and y down."""

    cx_px: float
    """Principal point along u, px."""
    cy_px: float
    """Principal point along v, px."""
    distortion: tuple[float, ...]
    """Numbers of the lens, in OpenCV's order."""
    distortion_model: str
    """Model of the lens."""
    fx_px: float
    """Focal length along u, px."""
    fy_px: float
    """Focal length along v, px."""
    height_px: int
    """Height of its pictures, px."""
    intrinsics_sigmas: tuple[float, ...]
    """Standard deviations of fx, fy, cx, cy (px) and of the lens, 0 where held; None: not known."""
    width_px: int
    """Width of its pictures, px."""


class BoardFound(AnyFound):
    """A board as a fit found it."""

    scale_percent: float
    """By how much it is larger than described, percent."""
    scale_sigma_percent: float | None
    """Standard deviation of that, percent; None: held."""


class LeftOpen(Record):
    """How far off the tool may be by what a fit to views leaves open, with base and tool where they fit best."""

    high_mm: float
    """Upper end of its 95 % interval, mm."""
    rms_mm: float
    """Root mean square distance that is expected, mm."""


class ToolScatter(Record):
    """How far off the tool is in views, the noise of the views taken off."""

    high_mm: float
    """Upper end, mm."""
    low_mm: float
    """Lower end of its 95 % interval, mm."""
    orientation_deg: float
    """Root mean square angle, degrees."""
    rms_mm: float
    """Root mean square distance, mm."""


class PixelsFound(Record):
    """What pixels alone say of their own noise and of the tool."""

    between_views: float
    """Variance between views over what their corners explain: 1 where the model lacks nothing."""
    given_mm: float | None
    """What hand-eye of the arm as it began leaves in the views that were fitted, mm: median, a rotation counted 0.3 m off; None: too few views."""
    left_open: LeftOpen | None
    """How far off the tool may be by what the fit leaves open, most of it along the lines of sight and in how large everything is: views hardly see that, held out or not. Null: not known."""
    noise_px: float
    """Standard deviation of a corner, px, from within views: no model enters."""
    shuffled_mm: float | None
    """The same with joints that belong to other views, mm: the negative control."""
    train: ToolScatter
    """The tool in the views that were fitted."""
    validation: ToolScatter | None
    """The tool in views held out; None: none, or folds."""
