"""What the server answers about search numbers, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records


class Place(Record):
    """A level of a factor at which the model was wrong."""

    excess: float | None
    """Squared error beyond what noise leaves, in multiples of that; 0 is none."""
    factor: str | None
    """What was looked at, such as the angle of a joint."""
    level: str | None
    """The level of it."""
    p_value: float | None
    """Chance of such an excess by noise."""
    visits: int | None
    """Visits at this level."""


class UnseenFit(Record):
    """Whether held-out rows, which no choice saw, agree with the model within the noise and what was fitted."""

    chi2: float | None
    """Squared errors in multiples of noise and of what was fitted."""
    chi2_all: float | None
    """`chi2` with rows set aside; None: none was set aside."""
    chi2_per_freedom: float | None
    """The one over the other; 1 is noise alone."""
    freedom: int | None
    """Numbers that were held out."""
    freedom_all: int | None
    """`freedom` with rows set aside; None: none was set aside."""
    left_mm: float | None
    """What is left of them, rms error in space, mm."""
    noise_mm: float | None
    """What noise and what was fitted leave of them, rms in space, mm."""
    p_value: float | None
    """Chance of so much by noise."""
    poses: int | None
    """Poses that were held out."""
    refuted: bool | None
    """Whether more is left, and more of it than is too small to matter."""


class Adequacy(Record):
    """Whether what is left is no more than the noise."""

    chi2: float | None
    """Squared residuals in multiples of the noise."""
    chi2_per_freedom: float | None
    """The one over the other; 1 is noise alone."""
    freedom: float | None
    """Degrees of freedom."""
    held_out: UnseenFit | None
    """The same of rows that no choice saw; None: not judged."""
    lack_of_fit_f: float | None
    """Lack of fit over pure error."""
    matters_mm: float | None
    """Size that matters, mm."""
    misfit_mm: float | None
    """Misfit beyond the noise, mm."""
    misfit_upper_mm: float | None
    """Upper bound of it, mm."""
    mostly_at: Place | None
    """Where what is left is clearest; None: nowhere, or nothing is."""
    p_value: float | None
    """Chance of so much by noise; None: the noise is not known."""
    p_value_low: float | None
    """Chance of so little by noise."""
    sentence: str | None
    """The model as a whole, in words."""
    too_small_to_matter: bool | None
    """Whether the misfit is below it."""


class AtJoints(Record):
    """An effect at some joints."""

    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""


class AliasPair(Record):
    """Two effects whose signatures correlate in these rows."""

    correlation: float | None
    """Correlation of their signatures, 0 to 1."""
    first: AtJoints
    """The one."""
    second: AtJoints
    """The other."""


class AliasMatrix(Record):
    """How well the signatures of effects correlate in these rows after the geometry is fitted."""

    labels: tuple[str, ...]
    """Effects of the matrix: those named and their nearest."""
    pairs: Records[AliasPair]
    """Every close pair of the library."""
    values: tuple[tuple[float, ...], ...]
    """Correlation of each two signatures, 0 to 1."""


class RepeatDrift(Record):
    """How far repeats drifted."""

    over_campaign_deg: float | None
    """Drift over the campaign, degrees of a joint."""
    over_campaign_mm: float | None
    """Drift over the campaign, mm."""
    p_value: float | None
    """Chance of such a drift by noise."""
    per_kelvin_deg: float | None
    """Drift per kelvin, degrees of a joint."""
    per_kelvin_mm: float | None
    """Drift per kelvin, mm."""
    seen: bool | None
    """Whether a drift was seen."""
    timed: bool | None
    """Whether by a clock; false: by the order of the rows."""


class GapNoise(Record):
    """The noise: standard deviations of a coordinate. Joint data have the `_deg` fields."""

    absolute: bool | None
    """Whether it is known apart from the fit."""
    correlated_samples: float | None
    """Rows in a row that count as one."""
    covariance: tuple[tuple[float, ...], ...]
    """Covariance of one row: mm, of poses the last three degrees."""
    drift: RepeatDrift | None
    """How far the repeats drifted; None: it cannot be determined."""
    freedom: float | None
    """Degrees of freedom it rests on; None: it was stated."""
    re_approach_deg: float | None
    """Between visits of a pose, degrees of a joint."""
    re_approach_mm: float | None
    """Between visits of a pose, mm."""
    rounding_mm: float | None
    """How far they move the tool, rms of a coordinate, mm."""
    rounding_steps: tuple[float, ...]
    """Steps of joint readings, deg (mm); None: none counts."""
    source: str | None
    """What it was estimated from."""
    within_visit_deg: float | None
    """Within a visit, degrees of a joint."""
    within_visit_mm: float | None
    """Within a visit, mm."""


class GapStep(Record):
    """A step of the search."""

    chi2_per_freedom: float | None
    """Misfit then, in multiples of what noise leaves."""
    names: tuple[str, ...]
    """What was named then."""


class Predictive(Record):
    """How many held-out coordinates are within their 95 % predictive intervals."""

    inside: int | None
    """Coordinates inside."""
    inside_all: int | None
    """Inside, of rows set aside too; None: none was set aside."""
    of: int | None
    """Coordinates in all."""
    of_all: int | None
    """Coordinates of rows set aside too; None: none was set aside."""
    poses: tuple[tuple[int, ...], ...]
    """Both numbers for each held-out pose."""


class GapSize(Record):
    """The gap before and after, as rms of the 3-D error, beside the noise. Joint data have the `_deg` fields."""

    after_deg: float | None
    """After, on the rows fitted, degrees of a joint."""
    after_mm: float | None
    """After, on the rows fitted, mm."""
    before_deg: float | None
    """Before, on the rows fitted, degrees of a joint."""
    before_mm: float | None
    """Before, on the rows fitted, mm."""
    closure: float | None
    """Share of the gap that is closed, 1 is all; None: noise not known."""
    held_out: str | None
    """How rows were held out."""
    held_out_set_aside: int | None
    """Held-out visits that no model predicts, set aside."""
    lengths: str | None
    """Where lengths are: `at_tool`, or `by_views`, beside its rotation, as sure as a typical view."""
    noise_deg: float | None
    """Standard deviation of the noise, degrees of a joint."""
    noise_mm: float | None
    """Standard deviation of one coordinate of the noise, mm."""
    noise_rms_deg: float | None
    """What noise alone would leave, degrees of a joint."""
    noise_rms_mm: float | None
    """What noise alone would leave, mm, to be compared with after."""
    predictive: Predictive | None
    """How the held-out rows lie in their 95 % intervals."""
    steps: Records[GapStep]
    """Steps of the search."""
    validation_after_all_deg: float | None
    """After, on every held-out row, those set aside too, degrees of a joint; None: none was."""
    validation_after_all_mm: float | None
    """After, on every held-out row, those set aside too, mm; None: none was set aside."""
    validation_after_deg: float | None
    """After, on the held-out rows, degrees of a joint."""
    validation_after_mm: float | None
    """After, on the held-out rows, mm."""
    validation_before_deg: float | None
    """Before, on the held-out rows, degrees of a joint."""
    validation_before_mm: float | None
    """Before, on the held-out rows, mm."""
    validation_noise_rms_deg: float | None
    """What noise alone would leave there, degrees."""
    validation_noise_rms_mm: float | None
    """What noise alone would leave there, mm."""


class ShuffledEffect(Record):
    """What became of an effect when its labels were shuffled."""

    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    passed: bool | None
    """Whether it vanished, as it must."""
    shuffled: str | None
    """What was shuffled."""
    shuffles: int | None
    """How often."""
    survived: float | None
    """Share in which it was still named, 0 to 1."""


class NegativeControl(Record):
    """What shuffled rows would name."""

    effects: Records[ShuffledEffect]
    """Every name."""
    names_in_shuffled_residuals: float | None
    """Share of shuffles that named anything, 0 to 1."""
    passed: bool | None
    """Whether every name vanished."""
    shuffles: int | None
    """How often rows were shuffled."""


class Evidence(Record):
    """The number that each gate was decided by; None where there was none."""

    adequate: float | None
    """p-value of the model with it."""
    bumped: float | None
    """1 when a local bump of its joint does as well."""
    confirmation: float | None
    """Standard deviations between the two amplitudes."""
    confirmation_p: float | None
    """p-value of no amplitude in the confirmation."""
    held_out: float | None
    """Standard deviations by which held-out errors follow the prediction."""
    inclusion: float | None
    """Share of resamples on which it returns, 0 to 1."""
    lasts: float | None
    """1 where its own evidence reaches; None: nothing else is left."""
    negative_control: float | None
    """Share of shuffles in which it was still named, 0 to 1."""
    no_empirical_alias: float | None
    """Points that the best shape is behind it."""
    physical: float | None
    """1 for a cause, 0 for a shape."""
    plausible: float | None
    """Standard deviations beyond what is plausible; below 0: within."""
    seen: float | None
    """1 when the rows show it."""
    sensor: float | None
    """Standard deviations in which a sensor at the place shows it."""
    shadowed: float | None
    """Largest correlation with an unknown curve that was needed too."""
    unseen_poses: float | None
    """Poses that took no part in choosing."""


class Gates(Record):
    """The tests an effect passed or did not; all must be passed to be confirmed. Null: not tested."""

    adequate: bool | None
    """Of earlier searches: the model with it agrees with the rows."""
    complete_geometry: bool | None
    """False: rotations the description lacks do as well."""
    confirmation: bool | None
    """A confirmation does not contradict it."""
    held_out: bool | None
    """Held-out poses gain by it."""
    inclusion: bool | None
    """It returns on resampled poses."""
    lasts: bool | None
    """Nothing else is left; or halves of the campaign, or a confirmation, bear it out all the same."""
    negative_control: bool | None
    """It vanishes when its labels are shuffled."""
    no_empirical_alias: bool | None
    """No shape without a cause does as well."""
    physical: bool | None
    """It is a cause, not a shape."""
    plausible: bool | None
    """Its amplitude is physically plausible."""
    seen: bool | None
    """The rows show it."""
    sensor: bool | None
    """A sensor at the place shows it; None: none is there."""
    unseen_poses: bool | None
    """Poses that took no part in choosing judged it."""


class Amplitude(Record):
    """A parameter of an effect that was named."""

    interval_high: float | None
    """Upper end of the 95 % interval."""
    interval_low: float | None
    """Lower end of the 95 % interval."""
    name: str
    """Name of the parameter."""
    seen: bool | None
    """Whether zero is outside its own interval."""
    sigma: float | None
    """Standard deviation of the value, in the fit of the version."""
    unit: str | None
    """Unit of the numbers: mm, deg, s, 1/K, ...; 1 for none."""
    value: float | None
    """Its value, as the search fitted it."""
