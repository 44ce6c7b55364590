"""What the server answers about comparisons, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownDiff
from kilter_client.typed.fits import Metrics


class Rival(Record):
    """What a version is compared with. It is worse when its error is larger by more than ``margin_mm``."""

    larger_by_mm: float
    """By how much the version's mean error is larger, mm; below 0: it is smaller."""
    margin_mm: float
    """By how much it may be larger by chance, mm."""
    mean_mm: float
    """Mean error of the rival, mm."""
    poses: int
    """Poses compared."""


class Comparison(Record):
    """Mean errors on rows that no version compared was fitted to, base and tool refitted to each campaign.

    ``active`` is None when no version was active, or when it cannot predict these rows or was fitted to all of them."""

    active: Rival | None
    """The version that was active, on the rows it can be compared on."""
    active_version: str | None
    """The version that was active."""
    campaign_names: tuple[str, ...]
    """What these campaigns are called, in the same order."""
    campaigns: tuple[str, ...]
    """Ids of the campaigns they are from."""
    mean_mm: float
    """Mean error of the version, mm."""
    poses: int
    """Poses they are at."""
    registration_only: Rival
    """The nominal robot, base and tool fitted."""
    rows: int
    """Rows compared."""


class PairedErrors(Record):
    """What two versions leave of the same rows, base and tool as each version has them. Rows of one pose count once."""

    better: int
    """On how many b leaves less."""
    campaigns: tuple[str, ...]
    """Ids of the campaigns."""
    chance: float
    """Probability of so uneven a count if neither were better: exact sign test, two-sided."""
    counted: str
    """What is counted: `rows` where no pose was repeated."""
    held_out: bool
    """Whether the rows were held out of both fits; false: there were none, so fitted rows are among them."""
    high_mm: float | None
    """Upper end of its 95 % interval, mm; None: too few."""
    less_mm: float
    """How much less b leaves, mean over what is counted, mm; negative: more."""
    low_mm: float | None
    """Lower end of its 95 % interval, mm; None: too few."""
    mean_a_mm: float
    """Mean error that a leaves, mm."""
    mean_b_mm: float
    """Mean error that b leaves, mm."""
    poses: int
    """Poses compared."""
    rows: int
    """Rows compared."""
    sentence: str
    """The same in words, all lengths in one unit."""
    worse: int
    """On how many it leaves more."""


class ParameterChange(Record):
    """A parameter in two versions; None where a version does not have it."""

    a: float | None
    """Value in version a."""
    b: float | None
    """Value in version b."""
    change: float | None
    """b minus a."""
    moved: bool
    """Whether they differ by more than 1.96 standard deviations of both, or only one has it."""
    name: str
    """Name of the parameter; base and tool are whole frames, `base_x` ... `tool_rz`."""
    sigma_a: float | None
    """Standard deviation in version a; None: not known, or nominal."""
    sigma_b: float | None
    """Standard deviation in version b; None: not known, or nominal."""
    unit: str
    """Unit of the numbers."""


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
    not_paired: str
    """Why rows are not compared, in words; empty: they are."""
    paired: PairedErrors | None
    """What both leave of the same rows, held out of both where there are such; None: see `not_paired`."""
    parameters: Records[ParameterChange]
    """All parameters of both, and how they differ."""


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
