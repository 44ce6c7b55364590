"""The parts of a gap search's result. Joint data have degrees where rows of a tool have mm."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from kilter_service.contract.fits import UNIT
from kilter_service.contract.units import Deg, Mm, Stored

JOINTS = "Joints it acts at, from 1; null: it does not act at joints."
ID = "Id of the effect."


class AtJoints(Stored):
    """An effect at some joints."""

    id: str = Field(description=ID)
    joints: list[int] | None = Field(None, description=JOINTS)


class Alias(AtJoints):
    """A rival that does as well."""

    behind: float | None = Field(None, description="Points of the criterion it is behind.")
    correlation: float | None = Field(None, description="Correlation of the two signatures, 0 to 1.")
    p_wrong: float | None = Field(None, description="Chance that the rival is the right one.")


class Amplitude(Stored):
    """A parameter of an effect that was named."""

    name: str = Field(description="Name of the parameter.")
    value: float | None = Field(None, description="Its value, as the search fitted it.")
    unit: str | None = Field(None, description=UNIT)
    sigma: float | None = Field(None, description="Standard deviation of the value, in the fit of the version.")
    interval_low: float | None = Field(None, description="Lower end of the 95 % interval.")
    interval_high: float | None = Field(None, description="Upper end of the 95 % interval.")
    seen: bool | None = Field(None, description="Whether zero is outside its own interval.")


class HeldOutGain(Stored):
    """What held-out poses gain by an effect."""

    gain: float | None = Field(None, description="Gain in the log-likelihood of the held-out poses.")
    standard_error: float | None = Field(None, description="Standard error of the gain.")
    deviations: float | None = Field(None, description="Standard deviations by which errors follow the prediction.")


class Gates(Stored):
    """The tests an effect passed or did not; all must be passed to be confirmed. Null: not tested."""

    physical: bool | None = Field(None, description="It is a cause, not a shape.")
    adequate: bool | None = Field(None, description="Of earlier searches: the model with it agrees with the rows.")
    lasts: bool | None = Field(
        None,
        description="Nothing else is left; or halves of the campaign, or a confirmation, bear it out all the same.",
    )
    held_out: bool | None = Field(None, description="Held-out poses gain by it.")
    unseen_poses: bool | None = Field(None, description="Poses that took no part in choosing judged it.")
    no_empirical_alias: bool | None = Field(None, description="No shape without a cause does as well.")
    plausible: bool | None = Field(None, description="Its amplitude is physically plausible.")
    seen: bool | None = Field(None, description="The rows show it.")
    inclusion: bool | None = Field(None, description="It returns on resampled poses.")
    negative_control: bool | None = Field(None, description="It vanishes when its labels are shuffled.")
    confirmation: bool | None = Field(None, description="A confirmation does not contradict it.")
    sensor: bool | None = Field(None, description="A sensor at the place shows it; null: none is there.")
    complete_geometry: bool | None = Field(None, description="False: rotations the description lacks do as well.")


class Evidence(Stored):
    """The number that each gate was decided by; null where there was none."""

    physical: float | None = Field(None, description="1 for a cause, 0 for a shape.")
    adequate: float | None = Field(None, description="p-value of the model with it.")
    lasts: float | None = Field(None, description="1 where its own evidence reaches; null: nothing else is left.")
    held_out: float | None = Field(
        None, description="Standard deviations by which held-out errors follow the prediction."
    )
    unseen_poses: float | None = Field(None, description="Poses that took no part in choosing.")
    no_empirical_alias: float | None = Field(None, description="Points that the best shape is behind it.")
    bumped: float | None = Field(None, description="1 when a local bump of its joint does as well.")
    shadowed: float | None = Field(None, description="Largest correlation with an unknown curve that was needed too.")
    plausible: float | None = Field(None, description="Standard deviations beyond what is plausible; below 0: within.")
    seen: float | None = Field(None, description="1 when the rows show it.")
    inclusion: float | None = Field(None, description="Share of resamples on which it returns, 0 to 1.")
    negative_control: float | None = Field(None, description="Share of shuffles in which it was still named, 0 to 1.")
    sensor: float | None = Field(None, description="Standard deviations in which a sensor at the place shows it.")
    confirmation: float | None = Field(None, description="Standard deviations between the two amplitudes.")
    confirmation_p: float | None = Field(None, description="p-value of no amplitude in the confirmation.")


class Amount(Stored):
    """A parameter as the confirmation has it."""

    name: str = Field(description="Name of the parameter.")
    value: float | None = Field(None, description="Its value.")
    unit: str | None = Field(None, description=UNIT)
    sigma: float | None = Field(None, description="Standard deviation of the value.")


class Replication(Stored):
    """What a confirmation says of an effect."""

    outcome: str | None = Field(
        None, description="`replicated`, `other_size`, `not_seen`, `contradicted` or `not_testable`."
    )
    parameters: list[Amount] | None = Field(None, description="Its amplitudes in the confirmation.")
    p_value: float | None = Field(None, description="Chance of such amplitudes without the effect.")
    apart_sigma: float | None = Field(None, description="Standard deviations between the two amplitudes.")
    reason: str | None = Field(None, description="Why nothing can be said, or what else contradicts.")
    with_mm: Mm | None = Field(
        None, description="Mean error of the confirmation with the effect as found, base and tool fitted to it, mm."
    )
    without_mm: Mm | None = Field(None, description="The same by the search's fit without the effect, mm.")


class Separation(Stored):
    """Evidence that would separate an effect from the others of its physical class."""

    name: str = Field(description="`turn`, `loads`, `sides`, `temperature`, `order` or `sensor`.")
    words: str | None = Field(None, description="What is asked for.")
    met: bool | None = Field(None, description="Whether these rows have it.")
    number: float | None = Field(None, description="What decided: revolutions, visits, a chance, or deviations.")
    told: str | None = Field(None, description="What these rows say of it, in words.")


class Claim(Stored):
    """What is claimed: the narrowest set that the data single out."""

    said: str = Field(description="Of what it is said: a `member` by its name, `one_of` several, or the `class`.")
    words: str = Field(description="The claim in words.")
    settled: bool | None = Field(None, description="Whether the model as a whole agrees with the rows.")
    joints: list[int] | None = Field(None, description="Joints that it is said of, from 1; null: acts at none.")
    evidence: list[Separation] | None = Field(None, description="What a member's name needs beside its shape.")


class PhysicalClass(Stored):
    """What acts at the same place in the same way, members of the library or not."""

    id: str = Field(description="Id of the class.")
    label: str = Field(description="The class with its joint, in words.")
    members: list[str] | None = Field(None, description="Members that the library has, by id.")
    outside: list[str] | None = Field(None, description="Members that it does not have, in words.")


class Halves(Stored):
    """What the two halves of a campaign, one after the other, say of an effect where something else is left."""

    lasts: bool | None = Field(None, description="Whether name, amplitude and prediction are the same in both.")
    named: list[bool] | None = Field(None, description="Whether each half alone names it, or its class.")
    apart_sigma: float | None = Field(None, description="Standard deviations between the two amplitudes.")
    with_mm: Mm | None = Field(None, description="Mean error of each half predicted by the other with it, mm.")
    without_mm: Mm | None = Field(None, description="The same without it, mm.")
    better: bool | None = Field(None, description="Whether that is better beyond chance.")
    joints: list[int] | None = Field(
        None, description="Its joints at which both halves name it, or its class, from 1; null: it acts at none."
    )


class NamedEffect(AtJoints):
    """An effect that was named, and how sure that is."""

    model_config = ConfigDict(serialize_by_alias=True, validate_by_name=True)

    verdict: str | None = Field(
        None,
        description="`replicated`, `confirmed`, `class_confirmed`, `provisional` or `contradicted`, the surest first.",
    )
    empirical: bool | None = Field(None, description="Whether it is a shape without a cause.")
    claim: Claim | None = Field(None, description="What is claimed: the narrowest set that the data single out.")
    physical_class: PhysicalClass | None = Field(None, description="What acts at the same place in the same way.")
    class_: str | None = Field(
        None, alias="class", description="The class that is claimed, in words; null: a member, or one of several."
    )
    alias_set: list[Alias] | None = Field(None, description="Rivals that do as well.")
    parameters: list[Amplitude] | None = Field(None, description="Its amplitudes.")
    seen_joints: list[int] | None = Field(None, description="Joints at which the rows show it, from 1.")
    gain_mm: float | None = Field(None, description="What it takes off the rms error, mm; degrees of joint data.")
    moves_mm: Mm | None = Field(None, description="Rms movement of the tool by it, as stored, mm; null: joint data.")
    too_small_to_matter: bool | None = Field(None, description="Whether that is too small to matter.")
    p_value: float | None = Field(None, description="Chance of such a gain by nothing, over the whole library.")
    inclusion: float | None = Field(None, description="Share of resamples on which it returns, 0 to 1.")
    held_out_gain: HeldOutGain | None = Field(None, description="What held-out poses gain by it.")
    gates: Gates | None = Field(None, description="The tests it passed.")
    evidence: Evidence | None = Field(None, description="The number that each test was decided by.")
    replication: Replication | None = Field(None, description="What the confirmation says; null: there was none.")
    halves: Halves | None = Field(
        None, description="What the campaign's halves say; null: not asked, or too few poses."
    )
    to_confirm: list[str] | None = Field(None, description="What would raise the verdict, in words.")
    campaign: str | None = Field(None, description="Campaign that shows it alone, as a mass that it does not state.")


class JointTorque(Stored):
    """What models leave of the torque of a joint, root mean square on rows that no choice saw."""

    joint: int = Field(description="The joint, from 1.")
    unit: str = Field(description="N m, or N of a prismatic joint.")
    rigid: float = Field(description="What rigid bodies leave.")
    friction: float = Field(description="What they leave with offset, Coulomb and viscous friction.")
    found: float = Field(description="What they leave with the effects that were found.")
    clipped_rows: int = Field(0, description="Rows left out because the drive or its sensor gave no more.")
    at_rest: bool = Field(False, description="Whether it never moved, so that nothing is said of it.")


class LinkBody(Stored):
    """A link as the torques of a log show it; what they do not show is as described."""

    link: int = Field(description="Link, from 1.")
    mass_kg: float = Field(description="Mass, kg.")
    centre_mm: list[float] = Field(description="Centre of mass in the frame of the link, mm.")
    inertia_kg_m2: list[list[float]] = Field(description="Inertia about the centre, in the axes of that frame, kg m2.")


class TorqueTerm(Stored):
    """A part of the torque of a joint beside its bodies, with its values; angles in rad."""

    id: str = Field(description="Effect.")
    joint: int = Field(description="Joint, from 1.")
    values: list[float] = Field(description="Its values, in the order of its parameters.")


class TorqueModel(Stored):
    """What tells the torques of a motion ahead: sums of masses and inertias, and friction."""

    base: list[float] = Field(description="Base parameters: the sums of masses and inertias that torques can tell.")
    links: list[LinkBody] = Field(description="Links that could be real and have these sums.")
    terms: list[TorqueTerm] = Field(description="Friction, and effects that unseen motions bore out.")
    joints: list[int] = Field(description="Joints, from 1, of which the log says something.")
    usual_speeds: list[float] = Field(
        description="Highest speed that each joint usually reached in the log, rad/s or m/s."
    )
    middles: list[float] = Field(description="Middle of the range of each joint in the log, rad or m.")
    orders: list[float | None] = Field(description="Order of the ripple of each joint per revolution; null: none.")
    mean_temperature_c: float | None = Field(None, description="Mean temperature in the log, degrees Celsius.")


class MotionFound(Stored):
    """What a log of joint torques says, as a whole."""

    joints: list[JointTorque] = Field(description="Errors of each joint.")
    friction: list[Amplitude] = Field(
        description="Offset and friction of each joint, and effects asked for that do not show; angles in rad, as in URDF."
    )
    motions: int = Field(description="Motions in the log.")
    seconds: float = Field(description="How long the joints moved, s.")
    unseen: bool = Field(description="Whether whole motions that no choice saw judged it.")
    base_parameters: int = Field(description="Number of sums of masses and inertias that torques can tell.")
    model: TorqueModel | None = Field(
        None, description="What tells torques ahead; null in searches of earlier releases."
    )


class Place(Stored):
    """A level of a factor at which the model was wrong."""

    factor: str | None = Field(None, description="What was looked at, such as the angle of a joint.")
    level: str | None = Field(None, description="The level of it.")
    excess: float | None = Field(
        None, description="Squared error beyond what noise leaves, in multiples of that; 0 is none."
    )
    p_value: float | None = Field(None, description="Chance of such an excess by noise.")
    visits: int | None = Field(None, description="Visits at this level.")


class Predictive(Stored):
    """How many held-out coordinates are within their 95 % predictive intervals."""

    inside: int | None = Field(None, description="Coordinates inside.")
    of: int | None = Field(None, description="Coordinates in all.")
    inside_all: int | None = Field(None, description="Inside, of rows set aside too; null: none was set aside.")
    of_all: int | None = Field(None, description="Coordinates of rows set aside too; null: none was set aside.")
    poses: list[list[int]] | None = Field(None, description="Both numbers for each held-out pose.")


class GapStep(Stored):
    """A step of the search."""

    names: list[str] | None = Field(None, description="What was named then.")
    chi2_per_freedom: float | None = Field(None, description="Misfit then, in multiples of what noise leaves.")


class GapSize(Stored):
    """The gap before and after, as rms of the 3-D error, beside the noise. Joint data have the `_deg` fields."""

    lengths: Literal["at_tool", "by_views"] | None = Field(
        None, description="Where lengths are: `at_tool`, or `by_views`, beside its rotation, as sure as a typical view."
    )
    before_mm: Mm | None = Field(None, description="Before, on the rows fitted, mm.")
    after_mm: Mm | None = Field(None, description="After, on the rows fitted, mm.")
    noise_mm: Mm | None = Field(None, description="Standard deviation of one coordinate of the noise, mm.")
    noise_rms_mm: Mm | None = Field(None, description="What noise alone would leave, mm, to be compared with after.")
    validation_before_mm: Mm | None = Field(None, description="Before, on the held-out rows, mm.")
    validation_after_mm: Mm | None = Field(None, description="After, on the held-out rows, mm.")
    validation_after_all_mm: Mm | None = Field(
        None, description="After, on every held-out row, those set aside too, mm; null: none was set aside."
    )
    validation_noise_rms_mm: Mm | None = Field(None, description="What noise alone would leave there, mm.")
    before_deg: Deg | None = Field(None, description="Before, on the rows fitted, degrees of a joint.")
    after_deg: Deg | None = Field(None, description="After, on the rows fitted, degrees of a joint.")
    noise_deg: Deg | None = Field(None, description="Standard deviation of the noise, degrees of a joint.")
    noise_rms_deg: Deg | None = Field(None, description="What noise alone would leave, degrees of a joint.")
    validation_before_deg: Deg | None = Field(None, description="Before, on the held-out rows, degrees of a joint.")
    validation_after_deg: Deg | None = Field(None, description="After, on the held-out rows, degrees of a joint.")
    validation_after_all_deg: Deg | None = Field(
        None, description="After, on every held-out row, those set aside too, degrees of a joint; null: none was."
    )
    validation_noise_rms_deg: Deg | None = Field(None, description="What noise alone would leave there, degrees.")
    closure: float | None = Field(None, description="Share of the gap that is closed, 1 is all; null: noise not known.")
    held_out: str | None = Field(None, description="How rows were held out.")
    held_out_set_aside: int | None = Field(None, description="Held-out visits that no model predicts, set aside.")
    predictive: Predictive | None = Field(None, description="How the held-out rows lie in their 95 % intervals.")
    steps: list[GapStep] | None = Field(None, description="Steps of the search.")


class UnseenFit(Stored):
    """Whether held-out rows, which no choice saw, agree with the model within the noise and what was fitted."""

    chi2: float | None = Field(None, description="Squared errors in multiples of noise and of what was fitted.")
    freedom: int | None = Field(None, description="Numbers that were held out.")
    chi2_per_freedom: float | None = Field(None, description="The one over the other; 1 is noise alone.")
    p_value: float | None = Field(None, description="Chance of so much by noise.")
    poses: int | None = Field(None, description="Poses that were held out.")
    left_mm: Mm | None = Field(None, description="What is left of them, rms error in space, mm.")
    noise_mm: Mm | None = Field(None, description="What noise and what was fitted leave of them, rms in space, mm.")
    refuted: bool | None = Field(None, description="Whether more is left, and more of it than is too small to matter.")
    chi2_all: float | None = Field(None, description="`chi2` with rows set aside; null: none was set aside.")
    freedom_all: int | None = Field(None, description="`freedom` with rows set aside; null: none was set aside.")


class Adequacy(Stored):
    """Whether what is left is no more than the noise."""

    chi2: float | None = Field(None, description="Squared residuals in multiples of the noise.")
    freedom: float | None = Field(None, description="Degrees of freedom.")
    chi2_per_freedom: float | None = Field(None, description="The one over the other; 1 is noise alone.")
    lack_of_fit_f: float | None = Field(None, description="Lack of fit over pure error.")
    p_value: float | None = Field(None, description="Chance of so much by noise; null: the noise is not known.")
    p_value_low: float | None = Field(None, description="Chance of so little by noise.")
    misfit_mm: Mm | None = Field(None, description="Misfit beyond the noise, mm.")
    misfit_upper_mm: Mm | None = Field(None, description="Upper bound of it, mm.")
    matters_mm: Mm | None = Field(None, description="Size that matters, mm.")
    too_small_to_matter: bool | None = Field(None, description="Whether the misfit is below it.")
    held_out: UnseenFit | None = Field(None, description="The same of rows that no choice saw; null: not judged.")
    sentence: str | None = Field(None, description="The model as a whole, in words.")
    mostly_at: Place | None = Field(None, description="Where what is left is clearest; null: nowhere, or nothing is.")


class RepeatDrift(Stored):
    """How far repeats drifted."""

    seen: bool | None = Field(None, description="Whether a drift was seen.")
    over_campaign_mm: Mm | None = Field(None, description="Drift over the campaign, mm.")
    per_kelvin_mm: Mm | None = Field(None, description="Drift per kelvin, mm.")
    over_campaign_deg: Deg | None = Field(None, description="Drift over the campaign, degrees of a joint.")
    per_kelvin_deg: Deg | None = Field(None, description="Drift per kelvin, degrees of a joint.")
    p_value: float | None = Field(None, description="Chance of such a drift by noise.")
    timed: bool | None = Field(None, description="Whether by a clock; false: by the order of the rows.")


class GapKind(Stored):
    """What a search says of one kind of measurement, in the kind's unit. Errors of the tool are rms lengths in space."""

    kind: str = Field(description="`points`, `poses`, `markers`, `contacts`, `link_encoders` or `inclination`.")
    unit: str | None = Field(None, description="Unit of its noise and errors: mm or deg.")
    numbers: int | None = Field(None, description="Numbers that the visits searched measured of it.")
    noise: float | None = Field(
        None, description="Standard deviation by which a number of a row was weighed, in `unit`."
    )
    repeats: float | None = Field(None, description="The same from repeats of a pose; null: no repeats of this kind.")
    before: float | None = Field(None, description="Rms error before, on the rows fitted.")
    after: float | None = Field(None, description="Rms error after, on the rows fitted.")
    validation_before: float | None = Field(None, description="Rms error before, on the held-out rows.")
    validation_after: float | None = Field(None, description="Rms error after, on the held-out rows.")


class GapNoise(Stored):
    """The noise: standard deviations of a coordinate. Joint data have the `_deg` fields."""

    source: str | None = Field(None, description="What it was estimated from.")
    absolute: bool | None = Field(None, description="Whether it is known apart from the fit.")
    freedom: float | None = Field(None, description="Degrees of freedom it rests on; null: it was stated.")
    within_visit_mm: Mm | None = Field(None, description="Within a visit, mm.")
    re_approach_mm: Mm | None = Field(None, description="Between visits of a pose, mm.")
    within_visit_deg: Deg | None = Field(None, description="Within a visit, degrees of a joint.")
    re_approach_deg: Deg | None = Field(None, description="Between visits of a pose, degrees of a joint.")
    covariance: list[list[float]] | None = Field(
        None, description="Covariance of one row: mm, of poses the last three degrees."
    )
    correlated_samples: float | None = Field(None, description="Rows in a row that count as one.")
    drift: RepeatDrift | None = Field(None, description="How far the repeats drifted; null: it cannot be determined.")
    rounding_steps: list[float] | None = Field(
        None, description="Steps of joint readings, deg (mm); null: none counts."
    )
    rounding_mm: Mm | None = Field(None, description="How far they move the tool, rms of a coordinate, mm.")


class Untestable(AtJoints):
    """What these rows cannot say."""

    reason: str | None = Field(None, description="Why.")
    remedy: str | None = Field(None, description="What to measure so that it can be tested.")
    missing: str | None = Field(None, description="What it lacks, in words that it shares with others of the list.")


class Detectable(Stored):
    """The smallest amplitude that would be seen."""

    id: str = Field(description=ID)
    parameter: str | None = Field(None, description="Name of the parameter.")
    unit: str | None = Field(None, description=UNIT)
    smallest_detectable: float | None = Field(None, description="Smallest amplitude that would be seen.")
    visibility: float | None = Field(None, description="Share of its signature that geometry cannot imitate, 0 to 1.")


class Refused(AtJoints):
    """A candidate that was tested and not named."""

    explains: float | None = Field(None, description="Share of the squared residuals that it would take away, 0 to 1.")
    p_value: float | None = Field(
        None, description="How often chance alone explains as much, of all candidates the best."
    )


class ShuffledEffect(AtJoints):
    """What became of an effect when its labels were shuffled."""

    shuffled: str | None = Field(None, description="What was shuffled.")
    shuffles: int | None = Field(None, description="How often.")
    survived: float | None = Field(None, description="Share in which it was still named, 0 to 1.")
    passed: bool | None = Field(None, description="Whether it vanished, as it must.")


class NegativeControl(Stored):
    """What shuffled rows would name."""

    passed: bool | None = Field(None, description="Whether every name vanished.")
    effects: list[ShuffledEffect] | None = Field(None, description="Every name.")
    shuffles: int | None = Field(None, description="How often rows were shuffled.")
    names_in_shuffled_residuals: float | None = Field(
        None, description="Share of shuffles that named anything, 0 to 1."
    )


class AliasPair(Stored):
    """Two effects whose signatures correlate in these rows."""

    first: AtJoints = Field(description="The one.")
    second: AtJoints = Field(description="The other.")
    correlation: float | None = Field(None, description="Correlation of their signatures, 0 to 1.")


class AliasMatrix(Stored):
    """How well the signatures of effects correlate in these rows after the geometry is fitted."""

    labels: list[str] | None = Field(None, description="Effects of the matrix: those named and their nearest.")
    values: list[list[float]] | None = Field(None, description="Correlation of each two signatures, 0 to 1.")
    pairs: list[AliasPair] | None = Field(None, description="Every close pair of the library.")
