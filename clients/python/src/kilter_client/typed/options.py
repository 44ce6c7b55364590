"""Options of jobs by name, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict


class DriftOptions(TypedDict, total=False):
    """What can be asked of a check."""

    new_setup: Sequence[Literal["base", "tool"]]
    """Frames that were set up anew: [], ["base"] or ["base", "tool"]. What looks like them is then not seen."""
    noise_mm: float | None
    """Standard deviation of a coordinate, mm, above 0; None: what the version's fit found."""
    setup_mm: float | None
    """Standard deviation with which the set-up repeats, mm; 0: it stays in place; None: as earlier checks show."""
    version: str | None
    """Id of the version to check against; None: the active one."""


class EvaluateOptions(TypedDict, total=False):
    """What can be asked of an evaluation."""

    criteria: Sequence[Literal["AP", "RP", "vAP", "AD", "RD", "AT", "RT", "dAP", "dRP"]]
    """Criteria of ISO 9283 that must be given; empty: all that the rows support."""
    metrics: Literal["errors", "iso9283"]
    """Errors, or the criteria of ISO 9283."""
    refit: Sequence[Literal["base", "tool"]]
    """Frames refitted to these rows: [], ["base"] or ["base", "tool"] (the tracker was set up again)."""
    version: str | None
    """Id of the version; None: the active one, else the nominal robot."""


class GapOptions(TypedDict, total=False):
    """What can be asked of a gap search."""

    alpha: float
    """Chance of any false name in the whole search, between 0 and 0.5."""
    base: Literal["free", "fixed"]
    """Whether the base is fitted."""
    bootstraps: int
    """Resamples behind the p-value of an effect, 1 to 20000."""
    budget_s: float | None
    """Seconds that a search may take, above 0: it then ends with the best it has; None: as many as it needs."""
    effects: Sequence[str | Mapping[str, Any]]
    """Look for these effects only, by id or at some joints; empty: for all."""
    fix: Sequence[str]
    """Parameters to hold, by name or pattern (`alpha_*`)."""
    free: Sequence[str]
    """Parameters to identify, by name or pattern (`alpha_*`); empty: those of the level."""
    limits: Mapping[str, Any] | None
    """The largest correction the version may make; None: what it needs at 99 % of its poses, from 1 degree and 5 mm to 5 degrees and 10 mm."""
    matters_um: float
    """Movement of the tool below which nothing matters, micrometres (um), 0 or more."""
    max_effects: int
    """Most effects to name, 1 to 50; an effect at several joints is one."""
    next_poses: int
    """Poses to propose, 0 to 1000."""
    noise_mm: float | None
    """Standard deviation of a coordinate, mm, above 0, where no pose was measured twice."""
    permutations: int
    """Shuffles of the negative control, 1 to 10000."""
    prior: Literal["fleet"] | None
    """`fleet`: add what versions of at least five other robots of this type say before the rows; None: none of them is asked."""
    reference: Literal["auto", "robot", "registration"]
    """Frames that corrections work in: the robot's own, those of the registration, or `auto`: the robot's own for a frame that is fixed or found within 10 mm and 1 degree of it."""
    refit: Sequence[Literal["tool"]]
    """["tool"]: every campaign and session has a tool of its own (a remounted marker); []: all rows share one."""
    resamples: int
    """Resamples of poses on which a name must return, 1 to 10000."""
    seed: int
    """Seed of everything that is drawn by chance, 0 or more."""
    start: str | None
    """Id of the version to continue from; None: the nominal robot."""
    tool: Literal["free", "fixed"]
    """Whether the tool is fitted."""


class IdentifyOptions(TypedDict, total=False):
    """What can be asked of an identification."""

    base: Literal["free", "fixed", "removed"]
    """Whether the base is fitted; `removed`: only distances between poses count."""
    com_sigma_mm: float | None
    """Standard deviation of each coordinate of every centre of mass, mm, above 0; None: what the robot says."""
    effects: Sequence[str | Mapping[str, Any]]
    """Effects to identify, by id or with options; empty: none, at level 3 the thesis's three."""
    fix: Sequence[str]
    """Parameters to hold, by name or pattern (`alpha_*`)."""
    free: Sequence[str]
    """Parameters to identify, by name or pattern (`alpha_*`); empty: those of the level."""
    intervals: Literal["bootstrap", "profile"] | None
    """Add 95 % intervals that do not rest on the covariance; None: none."""
    level: Literal[1, 2, 3] | None
    """1 joint offsets, 2 geometry, 3 geometry and effects; None: 3 when `effects` are named, else 2."""
    limits: Mapping[str, Any] | None
    """The largest correction the version may make; None: what it needs at 99 % of its poses, from 1 degree and 5 mm to 5 degrees and 10 mm."""
    loss: Literal["linear", "huber", "tukey"]
    """`huber` bounds what a wrong row can pull, `tukey` sets it aside and names it."""
    mass_sigma_percent: float | None
    """Standard deviation of every mass, percent of it, above 0; None: what the robot says of each."""
    masses: Literal["auto", "uncertain", "as_stated"]
    """`uncertain`: errors of masses and centres are carried beside effects that follow the load, as `load_error` does; `as_stated`: masses are exact; `auto`: uncertain, but beside an effect that follows the sign of a load values are fitted with masses as stated, and sigmas hold what their errors do."""
    method: Literal[
        "least_squares", "pose_pseudo_inverse", "influence", "kalman", "global_search", "linear_least_squares"
    ]
    """The estimator."""
    noise_mm: float | None
    """Standard deviation of a coordinate, mm, above 0; None: estimated from the rows."""
    prior: Literal["fleet"] | None
    """`fleet`: add what versions of at least five other robots of this type say before the rows; None: none of them is asked."""
    reference: Literal["auto", "robot", "registration"]
    """Frames that corrections work in: the robot's own, those of the registration, or `auto`: the robot's own for a frame that is fixed or found within 10 mm and 1 degree of it."""
    refit: Sequence[Literal["base", "tool"]] | None
    """["base"]: every campaign and session has a base of its own; ["tool"]: a tool (a remounted marker); []: all rows share one of each; None: the device decides, and sheets and ball bars have bases of their own."""
    search_deg: float
    """Half the width of a global search in angles, degrees, above 0."""
    search_mm: float
    """Half the width of a global search in lengths, mm, above 0."""
    seed: int
    """Seed of everything that is drawn by chance, 0 or more."""
    sheet_order: Literal["checked", "given"] | None
    """`given`: the quarter points of drawn sheets are in the right order, do not check; None: `checked`."""
    socket_distances_mm: Mapping[str, Any]
    """Known distances between ball sockets, mm, above 0: {"1-2": 400.0}."""
    start: str | None
    """Id of the version to start from; None: the nominal robot."""
    tilt_first: bool
    """Hold the effects while the geometry is identified: those of the start, else as fitted before it."""
    tool: Literal["free", "fixed"]
    """Whether the tool is fitted."""


class JointParametersOptions(TypedDict, total=False):
    """Readings to evaluate, or a joint to propose configurations for; neither, with campaigns of readings or encoders."""

    count: int
    """Configurations to propose, 4 to 200."""
    payload_com_mm: Sequence[float] | None
    """Of a proposal: centre of these loads in the tool frame, mm; None: the tool point."""
    payloads_kg: Sequence[float]
    """Loads at hand, kg, 0 or more."""
    propose: str | None
    """Name of the joint to propose configurations for."""
    readings: Sequence[Mapping[str, Any]]
    """Readings of an inclinometer."""
    resolution_deg: float
    """Resolution of the inclinometer, degrees, above 0."""
    seed: int
    """Seed of the choice, 0 or more."""


class PlanOptions(TypedDict, total=False):
    """What can be asked of a plan."""

    box_mm: Sequence[Sequence[float]] | None
    """Lowest and highest corner, mm, of a box the tool stays in, in the frame of the measurements."""
    count: int | None
    """Poses, 1 to 2000, or cycles; None: 118, 60, 12 or 5 poses by purpose, 30 cycles."""
    effects: Sequence[str | Mapping[str, Any]]
    """Of `identify`: effects to see; of `separate`: the two, or one to tell from geometry; empty: what the gap search that made the version left undecided."""
    floor_mm: float | None
    """Height in the robot's base frame, mm, that no joint and no tool point goes below."""
    keep_out_mm: Sequence[Sequence[Sequence[float]]]
    """Lowest and highest corners, mm, of boxes that no line between joints and tool enters, in the frame of the measurements."""
    method: Literal["d_optimal", "views", "iso9283", "five_poses", "two_poses"]
    """Of `identify`: `d_optimal`, `views` (the same of what cameras see of boards, which version or campaigns know) or the poses of `iso9283`; of `iso9283`: `five_poses` or `two_poses` for its cycles."""
    noise_mm: float | None
    """Standard deviation of a coordinate, or at the board of a corner that a camera sees, mm, above 0; None: that of the repeats, else 0.05."""
    payload_com_mm: Sequence[float] | None
    """Centre of these loads in the tool frame, mm; None: the tool point."""
    payloads_kg: Sequence[float]
    """Loads at hand, kg, 0 to 1000; used where an effect feels them."""
    prior: Literal["fleet"] | None
    """Of `identify` by `d_optimal`: `fleet`: add what versions of at least five other robots of this type say before the rows; None: none of them is asked."""
    purpose: Literal["iso9283", "identify", "separate", "check"]
    """`iso9283`: cube and planes of the standard; `identify`: poses that determine the parameters best; `separate`: poses that tell two effects apart; `check`: the few poses that best show whether the arm has moved."""
    seed: int
    """Seed of the choice, 0 or more."""
    version: str | None
    """Id of the version to plan with; None: the nominal robot."""
    within: Literal["campaigns", "limits"]
    """Where poses may be: where the robot was driven before, or anywhere in its limits."""
    without_joints: Sequence[int]
    """Of `check`: joints, from 1, whose zeros need not be seen."""


class RezeroOptions(TypedDict, total=False):
    """What can be asked of a re-zeroing."""

    causes: Sequence[str]
    """What moved: `zero_3`, `sag_2`, `base`, `tool`; empty: what a check of the rows names, if it is one cause."""
    limits: Mapping[str, Any] | None
    """The largest correction the version may make; None: what it needs at 99 % of its poses, from 1 degree and 5 mm to 5 degrees and 10 mm."""
    new_setup: Sequence[Literal["base", "tool"]]
    """Frames that were set up anew: [], ["base"] or ["base", "tool"]. The version keeps its own."""
    noise_mm: float | None
    """Standard deviation of a coordinate, mm, above 0; None: what the version's fit found."""
    setup_mm: float | None
    """Standard deviation with which the set-up repeats, mm; 0: it stays in place; None: as earlier checks show."""
    version: str | None
    """Id of the version to change; None: the active one."""
