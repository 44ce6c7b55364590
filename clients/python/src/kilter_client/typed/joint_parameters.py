"""What the server answers about joint parameters, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownFit
from kilter_client.typed.fits import Objection, Parameter, Remark


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Configuration(Record):
    """A configuration to read the inclinometer in."""

    axis: str | None
    """Axis of the joint's frame to read about."""
    joint: str | None
    """Name of the joint."""
    payload_com_mm: tuple[float, ...]
    """Its centre in the tool frame, mm; None: the tool point."""
    payload_kg: float | None
    """Load to carry, kg."""
    q_deg: tuple[float, ...]
    """All joints, degrees; mm for prismatic ones."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Motion(Record):
    """A motion of a joint, before and after what was found of it is taken off."""

    campaign: str | None
    """Id of the campaign."""
    left_deg: float | None
    """What is left of it, degrees."""
    raw_deg: float | None
    """Standard deviation of link minus motor angle, degrees."""
    use: str | None
    """`fitted` or `predicted`."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointMotions(Record):
    """A joint with an encoder on its link side."""

    dead: str | None
    """Why its channel says nothing; None: it does."""
    joint: str
    """Name of the joint."""
    motions: Records[Motion]
    """Its motions, fitted and predicted."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointParametersResult(ShownFit, Record):
    """What was measured of the joints, or where to read."""

    configurations: Records[Configuration]
    """Configurations to read."""
    csv: str | None
    """The configurations as a CSV file to fill in."""
    joint: str | None
    """The joint that configurations are proposed for."""
    joints: Records[JointMotions]
    """What link-side encoders say of each joint."""
    measured_by: str | None
    """`inclinometer` or `link-side encoder`."""
    objections: Records[Objection]
    """What it found against activating the version."""
    parameters: Records[Parameter]
    """Clearance, backlash and stiffness of the joints."""
    version_id: str | None
    """Id of the version it made; None: none."""
    warnings: Records[Remark]
    """What to know before trusting the result."""
