"""What the server answers about searches, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownSearch
from kilter_client.typed.effect_curves import EffectCurve
from kilter_client.typed.fits import Figure, LoadNumber, NullDirection, Objection, Reference, Remark
from kilter_client.typed.fleet_priors import PriorUsed
from kilter_client.typed.identifications import SetAside
from kilter_client.typed.search_numbers import (
    Adequacy,
    AliasMatrix,
    Amplitude,
    Evidence,
    GapNoise,
    GapSize,
    Gates,
    NegativeControl,
    Place,
    Predictive,
)


class Detectable(Record):
    """The smallest amplitude that would be seen."""

    id: str
    """Id of the effect."""
    parameter: str | None
    """Name of the parameter."""
    smallest_detectable: float | None
    """Smallest amplitude that would be seen."""
    unit: str | None
    """Unit of the numbers: mm, deg, s, 1/K, ...; 1 for none."""
    visibility: float | None
    """Share of its signature that geometry cannot imitate, 0 to 1."""


class GapKind(Record):
    """What a search says of one kind of measurement, in the kind's unit. Errors of the tool are rms lengths in space."""

    after: float | None
    """Rms error after, on the rows fitted."""
    before: float | None
    """Rms error before, on the rows fitted."""
    kind: str
    """`points`, `poses`, `markers`, `contacts`, `link_encoders` or `inclination`."""
    noise: float | None
    """Standard deviation by which a number of a row was weighed, in `unit`."""
    numbers: int | None
    """Numbers that the visits searched measured of it."""
    repeats: float | None
    """The same from repeats of a pose; None: no repeats of this kind."""
    unit: str | None
    """Unit of its noise and errors: mm or deg."""
    validation_after: float | None
    """Rms error after, on the held-out rows."""
    validation_before: float | None
    """Rms error before, on the held-out rows."""


class Alias(Record):
    """A rival that does as well."""

    behind: float | None
    """Points of the criterion it is behind."""
    correlation: float | None
    """Correlation of the two signatures, 0 to 1."""
    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    p_wrong: float | None
    """Chance that the rival is the right one."""


class Separation(Record):
    """Evidence that would separate an effect from the others of its physical class."""

    met: bool | None
    """Whether these rows have it."""
    name: str
    """`turn`, `loads`, `sides`, `temperature`, `order` or `sensor`."""
    number: float | None
    """What decided: revolutions, visits, a chance, or deviations."""
    told: str | None
    """What these rows say of it, in words."""
    words: str | None
    """What is asked for."""


class Claim(Record):
    """What is claimed: the narrowest set that the data single out."""

    evidence: Records[Separation]
    """What a member's name needs beside its shape."""
    joints: tuple[int, ...]
    """Joints that it is said of, from 1; None: acts at none."""
    said: str
    """Of what it is said: a `member` by its name, `one_of` several, or the `class`."""
    settled: bool | None
    """Whether the model as a whole agrees with the rows."""
    words: str
    """The claim in words."""


class Halves(Record):
    """What the two halves of a campaign, one after the other, say of an effect where something else is left."""

    apart_sigma: float | None
    """Standard deviations between the two amplitudes."""
    better: bool | None
    """Whether that is better beyond chance."""
    joints: tuple[int, ...]
    """Its joints at which both halves name it, or its class, from 1; None: it acts at none."""
    lasts: bool | None
    """Whether name, amplitude and prediction are the same in both."""
    named: tuple[bool, ...]
    """Whether each half alone names it, or its class."""
    with_mm: float | None
    """Mean error of each half predicted by the other with it, mm."""
    without_mm: float | None
    """The same without it, mm."""


class HeldOutGain(Record):
    """What held-out poses gain by an effect."""

    deviations: float | None
    """Standard deviations by which errors follow the prediction."""
    gain: float | None
    """Gain in the log-likelihood of the held-out poses."""
    standard_error: float | None
    """Standard error of the gain."""


class PhysicalClass(Record):
    """What acts at the same place in the same way, members of the library or not."""

    id: str
    """Id of the class."""
    label: str
    """The class with its joint, in words."""
    members: tuple[str, ...]
    """Members that the library has, by id."""
    outside: tuple[str, ...]
    """Members that it does not have, in words."""


class Amount(Record):
    """A parameter as the confirmation has it."""

    name: str
    """Name of the parameter."""
    sigma: float | None
    """Standard deviation of the value."""
    unit: str | None
    """Unit of the numbers: mm, deg, s, 1/K, ...; 1 for none."""
    value: float | None
    """Its value."""


class Replication(Record):
    """What a confirmation says of an effect."""

    apart_sigma: float | None
    """Standard deviations between the two amplitudes."""
    outcome: str | None
    """`replicated`, `not_seen`, `contradicted` or `not_testable`."""
    p_value: float | None
    """Chance of such amplitudes without the effect."""
    parameters: Records[Amount]
    """Its amplitudes in the confirmation."""
    reason: str | None
    """Why nothing can be said, or what else contradicts."""
    with_mm: float | None
    """Mean error of the confirmation with the effect as found, base and tool fitted to it, mm."""
    without_mm: float | None
    """The same by the search's fit without the effect, mm."""


class NamedEffect(Record):
    """An effect that was named, and how sure that is."""

    RENAMED: ClassVar[Mapping[str, str]] = {"class_": "class"}
    alias_set: Records[Alias]
    """Rivals that do as well."""
    claim: Claim | None
    """What is claimed: the narrowest set that the data single out."""
    class_: str | None
    """The class that is claimed, in words; None: a member, or one of several."""
    empirical: bool | None
    """Whether it is a shape without a cause."""
    evidence: Evidence | None
    """The number that each test was decided by."""
    gain_mm: float | None
    """What it takes off the rms error, mm; degrees of joint data."""
    gates: Gates | None
    """The tests it passed."""
    halves: Halves | None
    """What the campaign's halves say; None: not asked, or too few poses."""
    held_out_gain: HeldOutGain | None
    """What held-out poses gain by it."""
    id: str
    """Id of the effect."""
    inclusion: float | None
    """Share of resamples on which it returns, 0 to 1."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    moves_mm: float | None
    """Rms movement of the tool by it, as stored, mm; None: joint data."""
    p_value: float | None
    """Chance of such a gain by nothing, over the whole library."""
    parameters: Records[Amplitude]
    """Its amplitudes."""
    physical_class: PhysicalClass | None
    """What acts at the same place in the same way."""
    replication: Replication | None
    """What the confirmation says; None: there was none."""
    seen_joints: tuple[int, ...]
    """Joints at which the rows show it, from 1."""
    to_confirm: tuple[str, ...]
    """What would raise the verdict, in words."""
    too_small_to_matter: bool | None
    """Whether that is too small to matter."""
    verdict: str | None
    """`replicated`, `confirmed`, `class_confirmed`, `provisional` or `contradicted`, the surest first."""


class NextPose(Record):
    """A pose to measure next."""

    change: str | None
    """What to change before it, in words; None: nothing."""
    direction: tuple[int, ...]
    """Direction to reach each joint from, -1 or 1; None: any."""
    information_factor: float | None
    """How much more is known after it and all before it, as a factor."""
    kind: str | None
    """`new`, or what is done again."""
    payload_com_mm: tuple[float, ...]
    """Its centre in the tool frame, mm; None: the tool point."""
    payload_kg: float | None
    """Load to carry, kg; None: any."""
    q_deg: tuple[float, ...]
    """All joints, degrees; mm for prismatic ones."""
    separates: tuple[str, ...]
    """The two that it tells apart."""


class Refused(Record):
    """A candidate that was tested and not named."""

    explains: float | None
    """Share of the squared residuals that it would take away, 0 to 1."""
    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    p_value: float | None
    """How often chance alone explains as much, of all candidates the best."""


class ToldApart(Record):
    """Whether proposed poses tell two effects apart, and what does where they do not."""

    enough: bool | None
    """Whether they tell the two apart, but for one case in a thousand."""
    information_factor: float | None
    """How much more is known after all of them, as a factor; near 1: nothing."""
    instead: tuple[str, ...]
    """What to do instead, in words, the quickest first."""
    poses: int | None
    """How many poses are proposed for it."""
    poses_needed: int | None
    """How many such poses would; None: more than 1000."""
    sentence: str | None
    """All of it in words."""
    separates: tuple[str, ...]
    """The two in question."""


class Untestable(Record):
    """What these rows cannot say."""

    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    missing: str | None
    """What it lacks, in words that it shares with others of the list."""
    reason: str | None
    """Why."""
    remedy: str | None
    """What to measure so that it can be tested."""


class GapResult(ShownSearch, Record):
    """What a gap search found. The version holds the named effects and the geometry fitted with them."""

    adequacy: Adequacy | None
    """Whether the model now agrees with the rows."""
    alias_matrix: AliasMatrix | None
    """How well signatures correlate in these rows."""
    effect_curves: Records[EffectCurve]
    """Each named effect that moves a joint, over the quantity that it follows; None: earlier results."""
    effects: Records[NamedEffect]
    """Effects that were named."""
    figures: Mapping[str, Figure]
    """Figures by name."""
    gap: GapSize | None
    """How large the gap was and is, on rows fitted and held out."""
    load_model: Records[LoadNumber]
    """Masses and centres as stated and as found."""
    measurements: Records[GapKind]
    """Noise and errors, before and after, of each kind of measurement."""
    negative_control: NegativeControl | None
    """What shuffled rows would name."""
    next_poses: Records[NextPose]
    """Poses to measure next."""
    next_poses_csv: str | None
    """The same as a CSV file of columns of a measurement."""
    noise: GapNoise | None
    """The noise that the gap is compared with."""
    not_testable: Records[Untestable]
    """What these rows cannot say, and how they could."""
    null_directions: Records[NullDirection]
    """What these data cannot tell apart in the final model, and sums that they know; None: earlier results."""
    objections: Records[Objection]
    """What it found against activating the version."""
    predictive: Predictive | None
    """How the held-out rows lie in their 95 % intervals."""
    prior: PriorUsed | None
    """What other robots of the type said; None: they were not asked."""
    reference: Reference | None
    """Where the frames of a correction come from."""
    refused: Records[Refused]
    """What was tested and not named, with its score."""
    sentence: str | None
    """The verdict in words."""
    set_aside: Records[SetAside]
    """Rows that the search set aside, held out or not."""
    smallest_detectable: Records[Detectable]
    """Smallest amplitude that would be seen."""
    start: str | None
    """The version it continued from; None: the nominal robot."""
    told_apart: ToldApart | None
    """Whether they tell two effects apart; None: they make one surer, or there are none."""
    verdict: str | None
    """`no_gap`, `closed`, `provisional`, `unexplained`, or `not_known`: no noise is known apart from the fit."""
    version_id: str | None
    """Id of the version it made; None: none."""
    warnings: Records[Remark]
    """What to know before trusting the result."""
    where: Records[Place]
    """Where the model was wrong before."""
