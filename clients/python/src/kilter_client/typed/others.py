"""What the server answers about others, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records
from kilter_client.typed.comparisons import Comparison
from kilter_client.typed.fits import Objection, Remark
from kilter_client.typed.server import JobError, Progress


class AuditChange(Record):
    """One thing that a request changed."""

    after: str
    """What it is since, as JSON text; empty: it is gone."""
    before: str
    """What it was, as JSON text; empty: it was not there. A long value is its SHA-256."""
    thing: str
    """What it is: a kind of entry and its key, or `active_version`."""


class AuditEntry(Record):
    """What one request changed, and who sent it. Its hash covers `previous`, a line break and `content`."""

    actor: str
    """Name of the token; `admin`: the server's own."""
    address: str
    """Network address the request came from."""
    at: str
    """When it was changed."""
    changes: Records[AuditChange]
    """What was changed, at most 100 things."""
    content: str
    """All of this as it was stored, as JSON text: what the hash covers."""
    more: int
    """How many further things were changed."""
    number: int
    """Its number, from 1 without gaps."""
    place: str
    """What the path named, as JSON text."""
    previous: str
    """SHA-256 of the entry before; empty for the first."""
    role: str
    """Role of the token."""
    route: str
    """Method and path of the route."""
    sha256: str
    """SHA-256 of the entry."""
    token_id: str
    """Id of the token; empty: the server's own."""


class AuditPage(Record):
    """The audit, oldest first."""

    entries: Records[AuditEntry]
    """Entries of the audit, oldest first."""
    next: str | None
    """Give it as `after` for the page that follows; None: this is the last."""


class CheckedRows(Record):
    """What an upload to a robot would take; nothing was stored."""

    columns: tuple[str, ...]
    """Columns of the file, in its order."""
    rows: int
    """Rows of the file."""
    warnings: Records[Remark]
    """What looks odd in the rows and may be right: they are stored."""


class FleetCounts(Record):
    """How many robots are in which state."""

    cancelled: int
    """Robots whose job was cancelled."""
    failed: int
    """Robots whose job failed."""
    queued: int
    """Robots whose job waits."""
    refused: int
    """Robots that no job was made for."""
    running: int
    """Robots whose job computes."""
    succeeded: int
    """Robots with a new version."""


class FleetJobSummary(Record):
    """A fleet job in a list."""

    counts: FleetCounts
    """How many of them are in which state."""
    created_at: str
    """When it was asked for."""
    finished_at: str | None
    """When its last job was over; None: not yet."""
    id: str
    """Id of the fleet job, `flt_` and 16 hexadecimal digits."""
    name: str
    """What people call the job and the version it makes, at most 200 characters; empty: it has no name."""
    progress: Progress
    """How far it is, over all robots."""
    robots: int
    """How many robots it is about."""
    state: str
    """`queued` and `running` become one of the other three; `succeeded`: at least one robot has a new version, `failed`: none has."""


class FleetRobot(Record):
    """What became of a robot of a fleet job."""

    campaigns: tuple[str, ...]
    """Ids of the campaigns that are fitted."""
    compared: Comparison | None
    """How the two were compared; None: not yet, or not possible."""
    error: JobError | None
    """Why the robot was refused or its job failed."""
    held_out_after_mm: float | None
    """Mean error of the new version on the same poses, mm."""
    held_out_before_mm: float | None
    """Mean error of the version before, mm, on poses that neither it nor the new one was fitted to; None: not known, and `warnings` say why."""
    job_id: str | None
    """Id of its job; None: it was refused."""
    objections: Records[Objection]
    """What would refuse the activation of the new version."""
    robot: str
    """Name of the robot."""
    state: str
    """State of its job; `refused`: it has none, and `error` says why."""
    validation: tuple[str, ...] | float | None
    """What is held out: campaigns, or a fraction of the poses."""
    version_before: str | None
    """Version that was active when this was asked for; None: none."""
    version_id: str | None
    """The version that was made; None: none yet."""
    warnings: Records[Remark]
    """What the comparison left out."""


class FleetJob(FleetJobSummary):
    """A fleet job with a row for each robot."""

    report: Records[FleetRobot]
    """What became of each robot, by name."""


class Identity(Record):
    """Who sends this request, and what that allows."""

    actor: str
    """Name of the token; `admin`: the server's own; `anybody`: no token was needed."""
    robots: tuple[str, ...]
    """Names of the robots it is limited to; None: all robots. A robot of that name may be added later."""
    role: str
    """`viewer` reads; `operator` also uploads, runs jobs, corrects and activates; `admin` also has robots, tokens, purging and the audit."""
    token_id: str
    """Id of the token; empty: the server's own, or none."""


class LoginLink(Record):
    """A link that logs a browser in once, in the role of whoever asked for it."""

    expires_at: str
    """Until when it can be used, once."""
    path: str
    """To append to the address of the server. What is behind `#` stays in the browser and is in no log."""


class Token(Record):
    """A token; what is sent with requests is shown once, when it is made."""

    created_at: str
    """When it was made."""
    created_by: str
    """Who made it."""
    expires_at: str | None
    """When it expires; None: never."""
    id: str
    """Its id."""
    name: str
    """Whose token it is or what it is for; the records of changes show it."""
    revoked_at: str | None
    """When it was revoked; None: it was not."""
    revoked_by: str
    """Who revoked it; empty: nobody."""
    robots: tuple[str, ...]
    """Names of the robots it is limited to; None: all robots. A robot of that name may be added later."""
    role: str
    """`viewer` reads; `operator` also uploads, runs jobs, corrects and activates; `admin` also has robots, tokens, purging and the audit."""


class MadeToken(Token):
    """A token that was just made."""

    token: str
    """What to send with requests (KILTER_TOKEN); it is shown this once only."""


class ResidualRows(Record):
    """What a version leaves of rows, measured minus predicted, as columns; every one has a value for each row."""

    campaign: tuple[str, ...]
    """Id of the row's campaign."""
    dx_mm: tuple[float | None, ...]
    """Error along x, mm, the mean of the markers; None: nothing was seen."""
    dy_mm: tuple[float | None, ...]
    """Error along y, mm."""
    dz_mm: tuple[float | None, ...]
    """Error along z, mm."""
    held_out: tuple[bool, ...]
    """Whether the row was held out of the fit."""
    residual_sigma: tuple[float | None, ...]
    """Length of what is left in standard deviations of a coordinate; rotations count too."""
    row: tuple[int, ...]
    """Number of the row in its campaign, from 1."""
    set_aside: tuple[bool, ...]
    """Whether the identification set the row aside."""
    turn_deg: tuple[float | None, ...]
    """Error of the orientation, degrees; None: it was not measured."""
    u95_x_mm: tuple[float | None, ...]
    """Half width of the 95 % interval that expects the error along x, mm."""
    u95_y_mm: tuple[float | None, ...]
    """Half width of the 95 % interval along y, mm."""
    u95_z_mm: tuple[float | None, ...]
    """Half width of the 95 % interval along z, mm."""


class StreamSession(Record):
    """Id and keys of a session. Whoever has them can send setpoints on this stream."""

    announcement_key: str
    """Key with which the corrector signs what it announces about the robot, hexadecimal; a secret."""
    expires_at: str
    """When the session ends."""
    key: str
    """Key of the session, hexadecimal; a secret."""
    max_age_ms: float
    """A setpoint that arrives later than this after it was sent is refused, ms."""
    max_joints: int
    """Largest number of joints of a setpoint."""
    max_points: int
    """Largest number of points of a chunk."""
    robot: str
    """Name of the robot."""
    session: str
    """Id of the session, which every frame carries, hexadecimal."""
    site: str
    """Site in the keys of the stream."""
    stream: str
    """Name of the stream."""
    warnings: Records[Remark]
    """What to know before the arm is driven, as that nobody said whether the controller corrects by itself."""


class SuspiciousRow(Record):
    """A row that looks wrong, as one of those who say so sees it."""

    file: int
    """The file of the campaign that it is in, from 1."""
    file_row: int
    """Its row in that file, from 1."""
    held_out: bool
    """Whether the job held it out, and left it out of the errors on held-out rows."""
    job_id: str | None
    """The job."""
    mm: float | None
    """How far the row is from where it should be, mm; None: not known as a length."""
    row: int
    """Row of the campaign, from 1."""
    said_by: str
    """`rows`: the rows themselves, before any fit; `identification`, `search`: the job that made a version."""
    sigma: float | None
    """The same in standard deviations; None: not known."""
    version_id: str | None
    """The version of that job; None: no job says it."""
    version_name: str
    """Its name; empty: it has none."""
    weight: float | None
    """What it counts in that fit, 0 to 1; None: nothing was fitted, and the row counts."""
    why: str
    """What looks wrong, in words."""


class SuspiciousRows(Record):
    """All rows of a campaign that look wrong, by row; a row may be named by several."""

    campaign: str
    """Id of the campaign."""
    count: int
    """How many of them look wrong to somebody."""
    found: Records[SuspiciousRow]
    """What is said of them, by row, at most 2000 entries: the rest is counted."""
    name: str
    """Its name."""
    rows: int
    """Rows of the campaign."""
    sentence: str
    """The same in words."""


class UrdfShape(Record):
    """A shape that the robot's URDF gives a link: a file, or a box, cylinder or sphere."""

    box_mm: tuple[float, ...]
    """Sizes of a box about its centre, mm."""
    cylinder_mm: tuple[float, ...]
    """Radius and length of a cylinder along z about its centre, mm."""
    file: str | None
    """File of the mesh, in the URDF's words; None: a body of the sizes below."""
    link: str
    """Name of the joint that moves the link, or `base`."""
    scale: tuple[float, ...]
    """Factors of the file's coordinates to m."""
    sphere_mm: float | None
    """Radius of a sphere, mm."""
    transform: tuple[tuple[float, ...], ...]
    """Rows (4 by 4) that take the shape's own coordinates in mm to those of the link's mesh."""
    urdf_link: str
    """The URDF's name of the link."""


class UrdfShapes(Record):
    """What the robot's URDF draws of the arm."""

    left_out: tuple[str, ...]
    """The URDF's links behind joints that follow another: they have no mesh."""
    shapes: Records[UrdfShape]
    """Shapes, from base to tool."""
