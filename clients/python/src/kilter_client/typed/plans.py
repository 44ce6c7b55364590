"""What the server answers about plans, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownPlan
from kilter_client.typed.fits import Remark
from kilter_client.typed.searches import ToldApart


class PlannedPose(Record):
    """A pose to measure; further fields are the joints, as in a measurement: `q1_deg` ..., `q3_mm` of a prismatic joint."""

    change: str | None
    """What to change before it, in words; None: nothing."""
    direction: tuple[int, ...]
    """Direction to reach each joint from, -1 or 1; None: any."""
    information_factor: float | None
    """How much more is known after it, as a factor."""
    kind: str | None
    """`new`, or what is done again."""
    payload_com_mm: tuple[float, ...]
    """Its centre in the tool frame, mm; None: the tool point."""
    payload_kg: float | None
    """Load to carry, kg; None: any."""
    pose_id: int | None
    """Number of the pose, for the column of that name."""
    session: int | None
    """Number of the cycle, for the column of that name."""


class Proposal(Record):
    """Poses that belong together."""

    change: str | None
    """What to change before them, in words; None: nothing."""
    information_factor: float | None
    """How much more is known after them, as a factor."""
    kind: str | None
    """`new`, or what is done again."""
    poses: int | None
    """How many poses."""


class SmallestChange(Record):
    """The smallest change of a cause that such rows show in 95 % of the checks."""

    name: str
    """Name of the cause."""
    unit: str
    """Its unit."""
    value: float
    """How small; of base and tool a shift in the direction that shows least."""
    words: str
    """The cause as people say it."""


class PlanResult(ShownPlan, Record):
    """Poses to measure. Collisions are not checked."""

    correlation: float | None
    """Correlation of their signatures so far, 0 to 1."""
    count: int | None
    """How many poses."""
    csv: str | None
    """The poses as a CSV file of columns of a measurement."""
    cycles: int | None
    """Cycles of the standard's poses."""
    cycles_demanded: int | None
    """Cycles that the standard demands."""
    faint: tuple[str, ...]
    """Of `check`: zeros of which these poses do not show a small step, and what would, in words."""
    false_alarm: float | None
    """Of `check`: chance of a false alarm at which it will say `moved`."""
    poses: Records[PlannedPose]
    """The poses, in the order of a short path."""
    proposals: Records[Proposal]
    """The poses, by what to change before them."""
    purpose: str | None
    """What the poses are for."""
    separates: tuple[str, ...]
    """The two that the poses tell apart."""
    smallest: Records[SmallestChange]
    """Of `check`: the smallest changes that these poses show in 95 % of the checks."""
    start: str | None
    """The version it was planned with; None: the nominal robot."""
    told_apart: ToldApart | None
    """Of `separate`: whether the poses tell the two apart."""
    unseen: tuple[str, ...]
    """Of `check`: what these poses do not show, in words."""
    warnings: Records[Remark]
    """What to know before driving them."""
    within: str | None
    """Where poses were looked for."""
