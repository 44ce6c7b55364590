"""What the server answers about others, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_client.results.record import Record


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
