"""What the server answers about others, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_client.results.record import Record, Records


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AuditChange(Record):
    """One thing that a request changed."""

    after: str
    """What it is since, as JSON text; empty: it is gone."""
    before: str
    """What it was, as JSON text; empty: it was not there. A long value is its SHA-256."""
    thing: str
    """What it is: a kind of entry and its key, or `active_version`."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AuditPage(Record):
    """The audit, oldest first."""

    entries: Records[AuditEntry]
    """Entries of the audit, oldest first."""
    next: str | None
    """Give it as `after` for the page that follows; None: this is the last."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MadeToken(Record):
    """A token that was just made."""

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
    token: str
    """What to send with requests (KILTER_TOKEN); it is shown this once only."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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
