"""What the server answers about campaigns, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownCampaign, ShownUpload
from kilter_client.typed.fits import Remark


class Board(Record):
    """A board, or a solid of several, whose corners were seen."""

    corners_mm: tuple[tuple[float, ...], ...]
    """Corners 1, 2, ... in a frame of its own, mm."""
    mount: str
    """Whether it is on the flange, or in the room."""
    name: str
    """Its name; one name stands for one board in one place."""
    scale_sigma_percent: float | None
    """Standard deviation of its scale, percent: it is then fitted; None: the scale is exact."""


class Camera(Record):
    """A camera that measured; where it stands is fitted."""

    cx_px: float
    """Principal point along u, px; the centre of the top left pixel is 0."""
    cy_px: float
    """Principal point along v, px."""
    distortion: tuple[float, ...]
    """Numbers of the lens in OpenCV's order: k1, k2, p1, p2 (k3) (k4, k5, k6), of a fisheye k1 to k4."""
    distortion_model: str
    """Model of the lens."""
    fx_px: float
    """Focal length along u, px."""
    fy_px: float
    """Focal length along v, px."""
    height_px: int
    """Height of its pictures, px."""
    intrinsics: str | None
    """Whether a fit changes them; None: `prior` where `sigmas_px` are given, else `fixed`."""
    mount: str
    """`fixed`: in the room, it looks at boards on the flange; `flange`: it looks at fixed boards."""
    name: str
    """Its name; one name stands for one camera in one place."""
    sigmas_px: tuple[float, ...]
    """Standard deviations of fx, fy, cx, cy (px) and of each number of the lens, above 0; None: not stated."""
    width_px: int
    """Width of its pictures, px."""


class Conditions(Record):
    """What held during the whole campaign; a column of the rows takes precedence over it."""

    boards: Records[Board]
    """Boards that the cameras saw, in the order of their numbers; None: none."""
    calibration_sha256: str | None
    """SHA-256 of the file with the zeros of the arm's servos (LeRobot's calibration), 64 hexadecimal digits: all campaigns of a robot have the same; None: not stated."""
    cameras: Records[Camera]
    """Cameras whose pixels the rows have, in the order of their numbers; None: none."""
    payload_com_mm: tuple[float, ...]
    """Centre of the payload in the tool frame, mm; None: the tool point."""
    payload_kg: float | None
    """Mass at the tool point, kg, 0 or more; None: not known."""
    temperature_c: float | None
    """Temperature of the arm, degrees Celsius."""
    tool_force_n: tuple[float, ...]
    """Force on the tool point in the tool frame, N."""
    tool_moment_nm: tuple[float, ...]
    """Moment on the tool point in the tool frame, N m."""
    unchecked: bool | None
    """The rows are right, whatever they look like: upload and jobs warn where they would refuse; None: no."""


class Upload(Record):
    """A stored file of observations."""

    columns: tuple[str, ...]
    """Columns of the file, in its order."""
    created_at: str
    """When it was stored."""
    media_type: str
    """Media type it was sent as."""
    rows: int
    """Rows of the file."""
    sha256: str
    """SHA-256 of the bytes that were sent, 64 hexadecimal digits."""


class Campaign(ShownCampaign, Record):
    """A campaign and what was uploaded to it."""

    conditions: Conditions
    """What held during the whole campaign."""
    created_at: str
    """When it was added."""
    device: str
    """What it was measured with; `pencil`, `sheet` and `ballbar` have a frame of their own every time."""
    id: str
    """Id of the campaign, `cmp_` and 16 hexadecimal digits."""
    instrument: str | None
    """Name of the instrument it was measured with, as stored (`/v1/instruments`); None: not stated."""
    measured_at: str | None
    """When its last row was measured, with the time zone; None: not stated."""
    name: str
    """Name for people, at most 200 characters."""
    notes: str
    """Whatever else is worth knowing."""
    retired_at: str | None
    """Since when it is out of use; None: it is in use."""
    robot: str
    """Name of its robot."""
    role: str
    """What it is meant for; a job may use it otherwise."""
    rows: int
    """Rows of all its uploads."""
    staged: bool
    """Whether its parts come one by one, and it is hidden until they are all there."""
    uploads: Records[Upload]
    """Files stored, oldest first."""
    warnings: Records[Remark]
    """What the instrument's certificate has against it."""


class Uploaded(ShownUpload, Record):
    """What an upload became; ``new`` is false when the same bytes were there already."""

    campaign_id: str
    """Campaign it went to."""
    columns: tuple[str, ...]
    """Columns of the file, in its order."""
    new: bool
    """False when the same bytes were there already."""
    rows: int
    """Rows of the file."""
    sha256: str
    """SHA-256 of the bytes that were sent, 64 hexadecimal digits."""
    total_rows: int
    """Rows the campaign has now."""
    warnings: Records[Remark]
    """What looks odd in the rows and may be right: they are stored."""


class Instrument(Record):
    """A stored instrument."""

    certificate: str
    """Number of its calibration certificate; empty: none."""
    certified_on: str | None
    """Day of the certificate; None: not stated."""
    created_at: str
    """When it was added."""
    kind: str
    """What it is; `arm_cmm`: an articulated arm with a probe."""
    mpe_standard: str
    """What states its permissible error: ISO 10360-10 (laser trackers), ISO 10360-12 (articulated arms), or other, for instance its maker."""
    mpe_um: float
    """Maximum permissible error at length 0, micrometres: A of A + B L."""
    mpe_um_per_m: float
    """What it grows by per length, micrometres per metre: B of A + B L."""
    name: str
    """Name of the instrument with this certificate, unique on the server: letters, digits, `_`, `.` and `-`."""
    notes: str
    """Whatever else is worth knowing."""
    serial_number: str
    """Serial number, as on its plate."""
    valid_until: str | None
    """Last day on which it holds; None: not stated."""
