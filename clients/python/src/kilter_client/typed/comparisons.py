"""What the server answers about comparisons, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownDiff
from kilter_client.typed.fits import Metrics


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ParameterChange(Record):
    """A parameter in two versions; None where a version does not have it."""

    a: float | None
    """Value in version a."""
    b: float | None
    """Value in version b."""
    change: float | None
    """b minus a."""
    name: str
    """Name of the parameter; base and tool are whole frames, `base_x` ... `tool_rz`."""
    sigma_a: float | None
    """Standard deviation in version a; None: not known, or nominal."""
    sigma_b: float | None
    """Standard deviation in version b; None: not known, or nominal."""
    unit: str
    """Unit of the numbers."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class VersionDiff(ShownDiff, Record):
    """What differs from version a to version b; either may be `nominal`, the nominal robot."""

    a: str
    """Id of version a, or `nominal`."""
    b: str
    """Id of version b, or `nominal`."""
    effects_added: tuple[str, ...]
    """Ids of effects that only b has."""
    effects_removed: tuple[str, ...]
    """Ids of effects that only a has."""
    metrics_a: Metrics
    """Errors of a."""
    metrics_b: Metrics
    """Errors of b."""
    parameters: Records[ParameterChange]
    """All parameters of both, and how they differ."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tombstone(Record):
    """What is left of something that was purged."""

    at: str
    """When it was purged."""
    by: str
    """Who purged it."""
    id: str
    """The id it had; a robot's is its name."""
    kind: str
    """What it was."""
    name: str
    """What it was called."""
    robot: str
    """Name of the robot it belonged to."""
    sha256: str
    """Of a version its hash, of a robot that of its chain, of a campaign that of its uploads' hashes."""
