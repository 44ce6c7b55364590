"""What the server answers about acceptance, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records
from kilter_client.typed.budgets import Budget
from kilter_client.typed.fits import Errors, Remark


class JudgedCampaign(Record):
    """Rows of a campaign that the version was not fitted to, and what it leaves of them."""

    after: Errors
    """Errors of the version."""
    at_mm: tuple[tuple[float, ...], ...]
    """Measured places, mm; of many rows 500, evenly chosen."""
    before: Errors
    """Errors of the nominal robot, base and tool fitted to these rows."""
    budget: Budget
    """What is not known of these rows."""
    error_at_mm: tuple[float, ...]
    """The error at each of them, mm."""
    error_mm: float
    """Its error, mm."""
    guard_band_mm: float
    """Expanded uncertainty of that error, k = 2, mm: the guard band."""
    id: str
    """Id of the campaign."""
    instrument: str | None
    """Name of the instrument; None: none is named."""
    largest_mm: float
    """Largest error of a row, mm."""
    name: str
    """Its name."""
    provable_mm: float
    """Smallest tolerance that the rows prove, mm."""
    refit: tuple[str, ...]
    """Frames that were fitted to these rows; empty: none."""
    row: int
    """Row of the campaign that decides, from 1."""
    rows: int
    """Rows judged."""
    sha256: tuple[str, ...]
    """SHA-256 of its files."""
    when: str
    """When it was measured, in words."""


class Acceptance(Record):
    """A decision about a tolerance of the position of the tool."""

    campaigns: Records[JudgedCampaign]
    """The rows by campaign, the one that decides first."""
    decision: str
    """`accepted`: every error and its guard band are within the tolerance; `rejected`: an error is beyond it by its guard band; `not_proved`: neither can be proved."""
    lacking: Records[Remark]
    """Why nothing can be proved whatever the numbers; empty: nothing is lacking."""
    provable_mm: float
    """Smallest tolerance that all rows prove, mm."""
    robot: str
    """Name of the robot."""
    robot_sha256: str
    """SHA-256 of the robot's chain."""
    rows: int
    """Rows judged; no fit of the version or of one that it continues used them."""
    rule: str
    """The decision rule, in words."""
    sentence: str
    """The decision, in words."""
    span_mm: Mapping[str, tuple[float, ...]]
    """From where to where the rows were measured, by axis, mm."""
    tolerance_mm: float
    """Tolerance of the distance of the tool from where it should be, mm."""
    version_id: str
    """The version that was judged."""
    version_name: str
    """What people call it; empty: it has no name."""
    version_sha256: str
    """Its SHA-256."""
    warnings: Records[Remark]
    """What to know before trusting the decision."""
