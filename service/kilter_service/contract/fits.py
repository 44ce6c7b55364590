"""What a fit reports: errors, parameters, what it could not determine, warnings, and how uncertain it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

from pydantic import Field

from kilter_service.contract.budgets import Budget
from kilter_service.contract.devices import BoardFound, CameraFound, PixelsFound
from kilter_service.contract.units import Deg, Metres, Mm, Rad, Stored

SEARCHED_MASSES = (
    "Name of the search in torques whose masses count; null: those of the description, or no effect follows the load."
)


class Motion(Stored):
    """A motion of a joint, before and after what was found of it is taken off."""

    campaign: str | None = Field(None, description="Id of the campaign.")
    use: str | None = Field(None, description="`fitted` or `predicted`.")
    raw_deg: Deg | None = Field(None, description="Standard deviation of link minus motor angle, degrees.")
    left_deg: Deg | None = Field(None, description="What is left of it, degrees.")


class JointMotions(Stored):
    """A joint with an encoder on its link side."""

    joint: str = Field(description="Name of the joint.")
    dead: str | None = Field(None, description="Why its channel says nothing; null: it does.")
    motions: list[Motion] | None = Field(None, description="Its motions, fitted and predicted.")


class FleetVersion(Stored):
    """A version of another robot of the type."""

    robot: str = Field(description="Name of the robot.")
    version: str = Field(description="Id of its version.")
    reason: str | None = Field(None, description="Why a prior does without it; null: it is part of it.")


class LeftOneOut(Stored):
    """A robot as the others of its type predict it."""

    robot: str = Field(description="Name of the robot.")
    chi_square: float | None = Field(None, description="Chi-square of its parameters against the others' prior.")
    compared: int | None = Field(None, description="Parameters that were compared.")
    p_value: float | None = Field(None, description="Chance of as large a chi-square for a robot of the type.")


class PriorUsed(Stored):
    """What other robots of the type said beforehand, and how far this arm was believed to be as they are."""

    source: str | None = Field(None, description="`fleet`: versions of other robots of the type.")
    state: Literal["used", "widened", "dropped"] | None = Field(
        None,
        description="`used` as it is; `widened`, since this arm is odder than most, `odd` in some parameters, or moved by "
        "the type farther than its rows allow; `dropped`, since it is not as its type.",
    )
    widened_by: float | None = Field(None, description="Factor of its standard deviations; null: dropped.")
    limited_by: float | None = Field(
        None,
        description="Part of that factor, so that the type may move the tool by 0.26 of the error that is expected "
        "without it, and no more; 1: none. Null: stored without.",
    )
    chi_square: float | None = Field(None, description="Chi-square of the arm against its type.")
    compared: int | None = Field(None, description="Directions that were compared.")
    p_value: float | None = Field(None, description="Chance of as large a chi-square for a robot of the type.")
    odd: list[str] | None = Field(
        None, description="Parameters in which the arm is not as its type: the rows alone say."
    )
    parameters: list[str] | None = Field(None, description="Parameters that rest on the prior and not on the rows.")
    sentence: str | None = Field(None, description="All of that in words.")
    versions: list[FleetVersion] | None = Field(None, description="The versions it rests on.")
    left_out: list[FleetVersion] | None = Field(None, description="Versions of another gauge, which it does without.")
    left_one_out: list[LeftOneOut] | None = Field(None, description="how well the robots predict each other.")


class Term(Stored):
    """A parameter's part in a sum."""

    name: str = Field(description="Name of the parameter.")
    coefficient: float = Field(description="What it is multiplied by, each in its own unit.")


class IdentifiableSum(Stored):
    """A sum of parameters that the data know where they do not tell its members."""

    parameters: list[Term] = Field(description="Its terms.")
    value: float = Field(description="Value of the sum.")
    unit: str = Field(description="Unit of the numbers: that of the first parameter.")
    sigma: float = Field(description="Standard deviation.")
    lower: float = Field(description="Lower end of the 95 % interval.")
    upper: float = Field(description="Upper end of the 95 % interval.")
    sentence: str = Field(description="The same in words.")


AT_NOMINAL = 1e-9  # of a value, or of its unit: what rounding leaves of no change
MOSTLY = 0.5  # more than half of a number is what it mostly is
UNIT = "Unit of the numbers: mm, deg, s, 1/K, ...; 1 for none."


class Errors(Stored):
    """Errors of a model on some rows, measured minus predicted. Every marker that was seen counts as a point."""

    mean_mm: Mm = Field(description="Mean size of the errors, mm.")
    rms_mm: Mm | None = Field(None, description="Root mean square of the sizes, mm.")
    p95_mm: Mm | None = Field(None, description="Size that 95 % of the errors do not exceed, mm.")
    max_mm: Mm | None = Field(None, description="Largest error, mm.")
    x_mm: Mm | None = Field(None, description="Rms along x, mm; not for distances and contacts.")
    y_mm: Mm | None = Field(None, description="Rms along y, mm.")
    z_mm: Mm | None = Field(None, description="Rms along z, mm.")
    orientation_deg: Deg | None = Field(
        None, description="Mean error of the orientation, degrees, where it was measured."
    )


EARLIER_NAMES = {"geometry_fitted": "geometry_only", "without_effects": "geometry_only"}


def with_earlier_names(errors: dict[str, Any]) -> dict[str, Any]:
    """Return errors of several models with those that were renamed by their earlier name too, which scripts may read."""
    return errors | {old: errors[name] for name, old in EARLIER_NAMES.items() if name in errors}


def metrics_with_earlier_names(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the errors of a fit, those fitted and those held out, so; the latter are None where nothing was held out."""
    return {rows: errors and with_earlier_names(errors) for rows, errors in metrics.items()}


class StageErrors(Stored):
    """Errors of several models on the same rows."""

    n: int | None = Field(None, description="Points the errors are taken over.")
    left_out: int | None = Field(
        None, description="Rows that were left out of them, as no measurements; null: not known."
    )
    fitted: int | None = Field(
        None,
        description="Of an evaluation: rows that the version was fitted to, in whatever file; null: not looked for.",
    )
    nominal: Errors | None = Field(None, description="The nominal robot, in its own base and tool.")
    registration_only: Errors | None = Field(None, description="The nominal robot, base and tool fitted.")
    geometry_fitted: Errors | None = Field(
        None,
        description="Of a version, on rows held out: the geometry fitted to the same rows without effects, the best rigid arm; "
        "null: no effects, nothing held out, or not computed.",
    )
    without_effects: Errors | None = Field(
        None,
        description="Of an evaluation: the version with its effects left out and its geometry as it is, as a file of geometry "
        "alone has it; null: no effects, or not computed.",
    )
    geometry_only: Errors | None = Field(
        None,
        description="Earlier name, of two things: of an identification the same as `geometry_fitted`, of an evaluation as "
        "`without_effects`.",
    )
    identified: Errors | None = Field(None, description="The model that was identified.")
    uncorrected: Errors | None = Field(
        None,
        description="Of a check: the nominal robot in the frames of the version, which is the arm without its correction; "
        "null: not computed.",
    )
    budget: Budget | None = Field(
        None, description="What is not known of these rows, with the expanded uncertainty; null: not computed."
    )

    @property
    def best_rigid(self) -> Errors | None:
        """Of a version the geometry fitted without effects, as earlier releases stored it too."""
        return self.geometry_fitted or self.geometry_only

    @property
    def without_version(self) -> Errors | None:
        """The arm without the version: nominal, with base and tool anew where most of its error is where these are."""
        return self.uncorrected or (self.nominal if self.place_mm is None else self.registration_only)

    @property
    def place_mm(self) -> float | None:
        """What base and tool alone take off the nominal error, mm, where that is most of it; None: it is not.

        It says where instrument, base and tool are, and no version takes it away: it is not an error of the arm.
        """
        if self.nominal is None or self.registration_only is None:
            return None
        taken = self.nominal.mean_mm - self.registration_only.mean_mm
        return taken if taken > MOSTLY * self.nominal.mean_mm else None


class Metrics(Stored):
    """Errors of an identification; empty where no tool was measured."""

    train: StageErrors | None = Field(None, description="On the rows that were fitted.")
    validation: StageErrors | None = Field(None, description="On the rows that were held out; null: none were.")


class Parameter(Stored):
    """A parameter that was identified, in the unit it is read in."""

    name: str = Field(description="Name of the parameter.")
    unit: str | None = Field(None, description=UNIT)
    value: float | None = Field(None, description="Its value; null: it could not be measured.")
    nominal: float | None = Field(None, description="Its nominal value; 0 if the nominal robot does not have it.")
    change: float | None = Field(
        None, description="Value minus nominal; rotations of base and tool by the smaller angle."
    )
    sigma: float | None = Field(None, description="Standard deviation of the value.")
    lower: float | None = Field(None, description="Lower end of the 95 % interval, where `intervals` were asked for.")
    upper: float | None = Field(None, description="Upper end of the 95 % interval.")
    interval_from: str | None = Field(
        None, description="What the interval rests on: `bootstrap`, `profile`, or `sigma` where neither could be had."
    )
    identifiable: bool | None = Field(None, description="Whether the data could see it.")
    from_prior: bool | None = Field(
        None,
        description="Whether the value rests on other robots of the type, since the rows take off less than half of the "
        "variance; null: no prior was used.",
    )
    plausible: bool | None = Field(None, description="Whether the value is within what is usual.")
    readings: int | None = Field(None, description="Readings it rests on, in a job of kind `joint_parameters`.")
    reason: str | None = Field(None, description="Why it has no value, in words.")
    stiffness_nm_deg: float | None = Field(
        None, description="Stiffness of the joint, the inverse of its compliance, N m/deg."
    )


def split_nominal_and_moved(unknown: Iterable[Parameter]) -> tuple[list[Parameter], list[Parameter]]:
    """Tell parameters that the data could not see apart: those that are nominal, and those whose value is another guess."""
    nominal: list[Parameter] = []
    moved: list[Parameter] = []
    for one in unknown:
        change = one.change
        if change is None and one.value is not None and one.nominal is not None:
            change = one.value - one.nominal
        away = abs(change or 0.0)
        (nominal if away <= AT_NOMINAL * max(abs(one.nominal or 0.0), 1.0) else moved).append(one)
    return nominal, moved


class Member(Stored):
    """A parameter's part in a direction."""

    name: str = Field(description="Name of the parameter.")
    weight: float = Field(description="Its part, -1 to 1, by what it alone would do to the measurements.")


class NullDirection(Stored):
    """A combination of parameters that the data cannot tell."""

    parameters: list[Member] = Field(description="Its members, the largest first.")
    structural: bool | None = Field(None, description="Whether no pose at all could tell it.")
    sentence: str | None = Field(None, description="The same in words.")
    sums: list[IdentifiableSum] = Field([], description="Sums of its members that the data do know.")


class Covariance(Stored):
    """What a version knows of its parameters, SI; empty where nothing was identified."""

    names: list[str] | None = Field(None, description="Names of the parameters, in the order of the matrix.")
    matrix: list[list[float]] | None = Field(None, description="Covariance of the parameters, SI (m, rad, N m, ...).")
    units: str | None = Field(None, description="`SI`.")
    inadequacy_m: Metres | None = Field(
        None, description="Standard deviation of a coordinate that the fit left beyond the noise, m."
    )
    noise_m: Metres | None = Field(None, description="Standard deviation of a coordinate of the noise, m.")
    noise_of: str | None = Field(
        None,
        description="Kind of measurement whose noise that is, as `points`, `pixels` or `contacts`; null: not known. That of "
        "pixels and contacts is not taken for rows that an instrument measured.",
    )
    inadequacy_rad: Rad | None = Field(
        None,
        description="Standard deviation of a coordinate of the tool's rotation that a fit to views left beyond their noise, "
        "rad; null: not known.",
    )
    freedom: float | None = Field(
        None, description="Degrees of freedom of what the fit left, by which all of it is scaled; null: not known."
    )


class LoadNumber(Stored):
    """A mass or a coordinate of a centre, as stated and as the data leave it."""

    link: int | None = Field(None, description="Number of the link, from 1; null: the payload.")
    parameter: str = Field(description="`mass`, or a coordinate: `com_x` of a link, `shift_x` of the payload.")
    unit: str | None = Field(None, description="kg or mm.")
    stated: float | None = Field(None, description="What the robot or the campaign states.")
    value: float | None = Field(None, description="What the data leave of it.")
    sigma: float | None = Field(None, description="Standard deviation of the value.")
    prior_sigma: float | None = Field(None, description="Standard deviation that was stated.")
    seen: bool | None = Field(None, description="Whether the data could see it.")


class MassesTaken(Stored):
    """How an identification took masses and centres, where an effect follows the load."""

    carried: bool | None = Field(None, description="Whether their errors were carried beside the effects.")
    considered: bool | None = Field(
        None,
        description="Whether the standard deviations hold what errors of the masses do, the values fitted without.",
    )
    sentence: str | None = Field(None, description="With which standard deviations, and how to change that, in words.")


class Reference(Stored):
    """Where the frames that a correction works in come from."""

    base: str | None = Field(
        None, description="`robot`: the robot's own base; `registration`: where the nominal robot fits best."
    )
    tool: str | None = Field(None, description="The same of the tool.")


class SetAside(Stored):
    """A row that counts less than half in a fit with a robust loss, or that a search left out."""

    campaign: str | None = Field(None, description="Id of the campaign.")
    row: int = Field(description="Row of the campaign, from 1.")
    residual_sigma: float | None = Field(None, description="Length of what is left of it, in standard deviations.")
    residual_mm: Mm | None = Field(None, description="Distance of its point from the model's, mm.")
    weight: float | None = Field(None, description="What it counts, 0 to 1.")
    held_out: bool | None = Field(None, description="Whether a search held it out and left it out of those errors.")


class Scale(Stored):
    """The standard deviations that residuals were weighed by."""

    point_mm: Mm | None = Field(None, description="Of a coordinate of a point, mm.")
    turn_deg: Deg | None = Field(None, description="Of an orientation, degrees.")


class Noise(Stored):
    """What the rows of an identification scatter by."""

    residuals_mm: Mm | None = Field(None, description="Standard deviation of a coordinate of what the fit leaves, mm.")
    inadequacy_mm: Mm | None = Field(None, description="What of it is beyond the noise, mm.")
    between_visits_mm: Mm | None = Field(
        None, description="Standard deviation between visits of a pose, mm; null: no repeats."
    )
    between_shots_mm: Mm | None = Field(None, description="Standard deviation between shots without motion, mm.")
    wrong_rows: int | None = Field(None, description="Rows too far from the repeats of their pose to be noise.")


class Observability(Stored):
    """Observability indices of the poses, per prior standard deviation and in mm."""

    O1: float | None = Field(None, description="Geometric mean of the singular values over the root of the poses.")
    O2: float | None = Field(None, description="Smallest over largest singular value, 0 to 1.")
    O3: float | None = Field(None, description="Smallest singular value.")
    O4: float | None = Field(None, description="Smallest squared over largest singular value.")
    O5: float | None = Field(None, description="One over the sum of the inverse singular values.")
    rank: int | None = Field(None, description="Combinations of parameters that the poses can tell.")
    parameters: int | None = Field(None, description="Parameters that were free.")


class CorrelatedGroup(Stored):
    """Parameters that go together."""

    parameters: list[str] = Field(description="Names of the parameters.")
    correlation: float | None = Field(None, description="Strongest correlation between two of them, -1 to 1.")


class Influence(Stored):
    """How far a parameter moves the tool."""

    name: str = Field(description="Name of the parameter.")
    step: float | None = Field(None, description="Change that was imposed, in `unit`.")
    unit: str | None = Field(None, description=UNIT)
    mean_mm: Mm | None = Field(None, description="Mean movement of the tool over the poses, mm.")
    min_mm: Mm | None = Field(None, description="Least movement, mm.")
    max_mm: Mm | None = Field(None, description="Largest movement, mm.")
    mean_k: float | None = Field(
        None, description="Mean over the poses of its movement over the largest of any parameter, 0 to 1."
    )
    leads: float | None = Field(None, description="Share of the poses in which it moves the tool more than any other.")


class Learned(Stored):
    """Whether an effect that was learned predicts held-out poses better."""

    effects: list[str] | None = Field(None, description="Ids of the learned effects.")
    kept: bool | None = Field(None, description="Whether they stayed in the model.")
    poses: int | None = Field(None, description="Poses it was tried on.")
    held_out_without_mm: Mm | None = Field(None, description="Mean error on held-out poses without them, mm.")
    held_out_with_mm: Mm | None = Field(None, description="Mean error on held-out poses with them, mm.")
    p_value: float | None = Field(None, description="Chance of such a gain when there is none; null: not tried.")


class OwnBase(Stored):
    """A base, or a tool, that was fitted to rows of its own."""

    campaign: str | None = Field(None, description="Id of the campaign; null: the campaigns of other devices.")
    session: int | None = Field(None, description="Session of the campaign; null: all of it.")
    use: str | None = Field(None, description="What the rows were used for.")
    moved_mm: Mm | None = Field(None, description="How far it lies from the others', mm.")
    turned_deg: Deg | None = Field(None, description="How far it is rotated, degrees.")


class Method(Stored):
    """The method of a fit, and what it reports."""

    name: str | None = Field(None, description="Name of the method.")
    effects: str | None = Field(None, description="With `tilt_first`: whether effects were `held` or `fitted first`.")
    rows_left_out: int | None = Field(None, description="Rows that the fit left out.")
    linear_error: float | None = Field(
        None, description="Largest error of the linearisation, in standard deviations of a residual."
    )
    rows: int | None = Field(None, description="Rows that a filter took in.")
    continued: bool | None = Field(None, description="Whether a filter continued from a version's covariance.")
    mean_square_innovation: float | None = Field(
        None, description="Mean squared innovation of a filter; 1 is as expected."
    )
    evaluations: int | None = Field(None, description="Models that a global search tried.")
    best_mm: Mm | None = Field(None, description="Error at the best point of a global search, mm.")
    start_mm: Mm | None = Field(None, description="Error at its start, mm.")
    needed: bool | None = Field(None, description="Whether the search found what a plain fit does not.")
    sweeps: int | None = Field(None, description="Sweeps over the poses of a method that goes pose by pose.")
    settled: bool | None = Field(None, description="Whether the sweeps settled.")


class KindErrors(Stored):
    """Rms error of each model on what one kind measured, in the kind's unit."""

    nominal: float | None = Field(None, description="The nominal robot, in its own base and tool.")
    registration_only: float | None = Field(None, description="The nominal robot, base and tool fitted.")
    identified: float | None = Field(None, description="The model that was identified.")


class KindOfMeasurement(Stored):
    """What one kind of measurement says in a fit."""

    kind: str = Field(
        description="`points`, `poses`, `markers`, `distances`, `contacts`, `link_encoders` or `inclination`."
    )
    unit: str | None = Field(None, description="Unit of its noise and errors: mm or deg.")
    numbers: int | None = Field(None, description="Independent numbers that it measured.")
    noise: float | None = Field(None, description="Standard deviation by which its numbers were weighed, in `unit`.")
    repeats: float | None = Field(None, description="The same from repeats of a pose; null: no repeats of this kind.")
    train: KindErrors | None = Field(None, description="Rms errors on the rows that were fitted.")
    validation: KindErrors | None = Field(None, description="Rms errors on the rows that were held out.")
    tells_alone: list[str] | None = Field(None, description="Parameters that it tells without the others.")
    known_because_of_it: list[str] | None = Field(
        None, description="Parameters that are known with it, and would not be by the other kinds alone."
    )
    sharpens: dict[str, float] | None = Field(
        None, description="Other parameters, and how many times more certain they are with it."
    )


class FitDetails(Stored):
    """What an identification reports besides its parameters and errors."""

    noise_source: str | None = Field(None, description="What the noise was estimated from.")
    scale: Scale | None = Field(None, description="The standard deviations that residuals were weighed by.")
    noise: Noise | None = Field(None, description="What the rows scatter by.")
    set_aside: list[SetAside] | None = Field(None, description="Rows that a robust loss or a search set aside.")
    iterations: int | None = Field(None, description="Iterations of the fit.")
    method: Method | None = Field(None, description="The method, and what it reports.")
    influence: list[Influence] | None = Field(
        None, description="How far each parameter moves the tool, at up to 500 rows (all with method `influence`)."
    )
    intervals: str | None = Field(None, description="What the intervals rest on: `bootstrap` or `profile`.")
    learned: Learned | None = Field(None, description="Whether a learned effect predicts better.")
    load_model: list[LoadNumber] | None = Field(None, description="Masses and centres as stated and as found.")
    masses: MassesTaken | None = Field(None, description="How masses were taken; null: no effect follows the load.")
    masses_from: str | None = Field(None, description=SEARCHED_MASSES)
    observability: Observability | None = Field(None, description="Observability indices of the poses.")
    correlated_groups: list[CorrelatedGroup] | None = Field(None, description="Parameters that go together.")
    base_refitted: list[OwnBase] | None = Field(None, description="Bases that were fitted to rows of their own.")
    tool_refitted: list[OwnBase] | None = Field(None, description="Tools that were fitted to rows of their own.")
    reference: Reference | None = Field(None, description="Where the frames of a correction come from.")
    prior: PriorUsed | None = Field(None, description="What other robots of the type said; null: they were not asked.")
    measurements: list[KindOfMeasurement] | None = Field(None, description="What each kind of measurement says.")
    cameras: list[CameraFound] | None = Field(None, description="Cameras as they were found; null: none measured.")
    boards: list[BoardFound] | None = Field(None, description="Boards as they were found; null: none measured.")
    pixels: PixelsFound | None = Field(
        None, description="What views alone say; null: a tracker measured too, or no camera."
    )
    known_together: list[str] | None = Field(
        None, description="Parameters that the kinds tell together and none of them alone."
    )
