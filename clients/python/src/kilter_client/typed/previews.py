"""What the server answers about previews, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records


class JointPreview(Record):
    """The largest correction of a joint."""

    joint: str
    """Name of the joint."""
    largest_at: tuple[float, ...]
    """The joints there: degrees, mm for prismatic ones."""
    largest_deg: float | None
    """Largest correction, degrees; None: prismatic, or nothing was corrected."""
    largest_mm: float | None
    """Largest correction, mm; None: revolute, or nothing was corrected."""


class VersionPreview(Record):
    """How a version would correct, without activating it: what `correct` does with these poses, within its limits."""

    corrected: int
    """How many of them get corrected joints, damped and limited ones among them."""
    corrected_where_stated: Mapping[str, tuple[str, ...]]
    """Those of them that rows of a file are corrected for, by id with the columns that rows must state."""
    damped: int
    """How many of these keep more of their error than is stated: a singularity is near, or out of reach."""
    joints: Records[JointPreview]
    """The largest correction of each joint."""
    largest_at: tuple[float, ...]
    """The joints there: degrees, mm for prismatic ones."""
    largest_mm: float | None
    """Largest movement of the tool by the correction, mm; None: as above."""
    left_at: tuple[float, ...]
    """The joints there: degrees, mm for prismatic ones."""
    left_mm: float | None
    """The most that a correction leaves of the tool's error by the version, mm; None: as above."""
    limited: int
    """How many of these keep more of their error than is stated because the correction is at a limit."""
    mean_mm: float | None
    """Mean movement of the tool by the correction, mm; None: nothing was corrected."""
    not_corrected: str
    """Both in words; empty: nothing is left out."""
    poses: int
    """How many poses were looked at."""
    refused: Mapping[str, int]
    """The others, by why they would be refused, such as `CORRECTION_TOO_LARGE` for its limits."""
    temperature_c: float | None
    """Temperature it was looked at with, degrees Celsius; None: not known."""
    unsupported_effects: tuple[str, ...]
    """Ids of its effects that would not be corrected where rows state joints and loads alone, as in a stream."""
    version_id: str
    """Id of the version."""
    within: str
    """Poses looked at: `campaigns`, where the robot was driven before; `limits`, anywhere in its limits."""
