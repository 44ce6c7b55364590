"""What the server answers about identifications, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownFit
from kilter_client.typed.cameras import BoardFound, CameraFound, PixelsFound
from kilter_client.typed.fits import Figure, LoadNumber, Metrics, NullDirection, Objection, Parameter, Reference, Remark
from kilter_client.typed.fleet_priors import PriorUsed


class CorrelatedGroup(Record):
    """Parameters that go together."""

    correlation: float | None
    """Strongest correlation between two of them, -1 to 1."""
    parameters: tuple[str, ...]
    """Names of the parameters."""


class Influence(Record):
    """How far a parameter moves the tool."""

    leads: float | None
    """Share of the poses in which it moves the tool more than any other."""
    max_mm: float | None
    """Largest movement, mm."""
    mean_k: float | None
    """Mean over the poses of its movement over the largest of any parameter, 0 to 1."""
    mean_mm: float | None
    """Mean movement of the tool over the poses, mm."""
    min_mm: float | None
    """Least movement, mm."""
    name: str
    """Name of the parameter."""
    step: float | None
    """Change that was imposed, in `unit`."""
    unit: str | None
    """Unit of the numbers: mm, deg, s, 1/K, ...; 1 for none."""


class KindErrors(Record):
    """Rms error of each model on what one kind measured, in the kind's unit."""

    identified: float | None
    """The model that was identified."""
    nominal: float | None
    """The nominal robot, in its own base and tool."""
    registration_only: float | None
    """The nominal robot, base and tool fitted."""


class KindOfMeasurement(Record):
    """What one kind of measurement says in a fit."""

    kind: str
    """`points`, `poses`, `markers`, `distances`, `contacts`, `link_encoders` or `inclination`."""
    known_because_of_it: tuple[str, ...]
    """Parameters that are known with it, and would not be by the other kinds alone."""
    noise: float | None
    """Standard deviation by which its numbers were weighed, in `unit`."""
    numbers: int | None
    """Independent numbers that it measured."""
    repeats: float | None
    """The same from repeats of a pose; None: no repeats of this kind."""
    sharpens: Mapping[str, float]
    """Other parameters, and how many times more certain they are with it."""
    tells_alone: tuple[str, ...]
    """Parameters that it tells without the others."""
    train: KindErrors | None
    """Rms errors on the rows that were fitted."""
    unit: str | None
    """Unit of its noise and errors: mm or deg."""
    validation: KindErrors | None
    """Rms errors on the rows that were held out."""


class Learned(Record):
    """Whether an effect that was learned predicts held-out poses better."""

    effects: tuple[str, ...]
    """Ids of the learned effects."""
    held_out_with_mm: float | None
    """Mean error on held-out poses with them, mm."""
    held_out_without_mm: float | None
    """Mean error on held-out poses without them, mm."""
    kept: bool | None
    """Whether they stayed in the model."""
    p_value: float | None
    """Chance of such a gain when there is none; None: not tried."""
    poses: int | None
    """Poses it was tried on."""


class MassesTaken(Record):
    """How an identification took masses and centres, where an effect follows the load."""

    carried: bool | None
    """Whether their errors were carried beside the effects."""
    considered: bool | None
    """Whether the standard deviations hold what errors of the masses do, the values fitted without."""
    sentence: str | None
    """With which standard deviations, and how to change that, in words."""


class Method(Record):
    """The method of a fit, and what it reports."""

    best_mm: float | None
    """Error at the best point of a global search, mm."""
    continued: bool | None
    """Whether a filter continued from a version's covariance."""
    effects: str | None
    """With `tilt_first`: whether effects were `held` or `fitted first`."""
    evaluations: int | None
    """Models that a global search tried."""
    linear_error: float | None
    """Largest error of the linearisation, in standard deviations of a residual."""
    mean_square_innovation: float | None
    """Mean squared innovation of a filter; 1 is as expected."""
    name: str | None
    """Name of the method."""
    needed: bool | None
    """Whether the search found what a plain fit does not."""
    rows: int | None
    """Rows that a filter took in."""
    rows_left_out: int | None
    """Rows that the fit left out."""
    settled: bool | None
    """Whether the sweeps settled."""
    start_mm: float | None
    """Error at its start, mm."""
    sweeps: int | None
    """Sweeps over the poses of a method that goes pose by pose."""


class Noise(Record):
    """What the rows of an identification scatter by."""

    between_shots_mm: float | None
    """Standard deviation between shots without motion, mm."""
    between_visits_mm: float | None
    """Standard deviation between visits of a pose, mm; None: no repeats."""
    inadequacy_mm: float | None
    """What of it is beyond the noise, mm."""
    residuals_mm: float | None
    """Standard deviation of a coordinate of what the fit leaves, mm."""
    wrong_rows: int | None
    """Rows too far from the repeats of their pose to be noise."""


class Observability(Record):
    """Observability indices of the poses, per prior standard deviation and in mm."""

    O1: float | None
    """Geometric mean of the singular values over the root of the poses."""
    O2: float | None
    """Smallest over largest singular value, 0 to 1."""
    O3: float | None
    """Smallest singular value."""
    O4: float | None
    """Smallest squared over largest singular value."""
    O5: float | None
    """One over the sum of the inverse singular values."""
    parameters: int | None
    """Parameters that were free."""
    rank: int | None
    """Combinations of parameters that the poses can tell."""


class OwnBase(Record):
    """A base, or a tool, that was fitted to rows of its own."""

    campaign: str | None
    """Id of the campaign; None: the campaigns of other devices."""
    moved_mm: float | None
    """How far it lies from the others', mm."""
    session: int | None
    """Session of the campaign; None: all of it."""
    turned_deg: float | None
    """How far it is rotated, degrees."""
    use: str | None
    """What the rows were used for."""


class Scale(Record):
    """The standard deviations that residuals were weighed by."""

    point_mm: float | None
    """Of a coordinate of a point, mm."""
    turn_deg: float | None
    """Of an orientation, degrees."""


class SetAside(Record):
    """A row that counts less than half in a fit with a robust loss, or that a search left out."""

    campaign: str | None
    """Id of the campaign."""
    held_out: bool | None
    """Whether a search held it out and left it out of those errors."""
    residual_mm: float | None
    """Distance of its point from the model's, mm."""
    residual_sigma: float | None
    """Length of what is left of it, in standard deviations."""
    row: int
    """Row of the campaign, from 1."""
    weight: float | None
    """What it counts, 0 to 1."""


class AnyFit(Record):
    """What a fit says of itself, as a result and within its version."""

    base_refitted: Records[OwnBase]
    """Bases that were fitted to rows of their own."""
    boards: Records[BoardFound]
    """Boards as they were found; None: none measured."""
    cameras: Records[CameraFound]
    """Cameras as they were found; None: none measured."""
    correlated_groups: Records[CorrelatedGroup]
    """Parameters that go together."""
    influence: Records[Influence]
    """How far each parameter moves the tool, at up to 500 rows (all with method `influence`)."""
    intervals: str | None
    """What the intervals rest on: `bootstrap` or `profile`."""
    iterations: int | None
    """Iterations of the fit."""
    known_together: tuple[str, ...]
    """Parameters that the kinds tell together and none of them alone."""
    learned: Learned | None
    """Whether a learned effect predicts better."""
    load_model: Records[LoadNumber]
    """Masses and centres as stated and as found."""
    masses: MassesTaken | None
    """How masses were taken; None: no effect follows the load."""
    measurements: Records[KindOfMeasurement]
    """What each kind of measurement says."""
    method: Method | None
    """The method, and what it reports."""
    noise: Noise | None
    """What the rows scatter by."""
    noise_source: str | None
    """What the noise was estimated from."""
    observability: Observability | None
    """Observability indices of the poses."""
    pixels: PixelsFound | None
    """What views alone say; None: a tracker measured too, or no camera."""
    prior: PriorUsed | None
    """What other robots of the type said; None: they were not asked."""
    reference: Reference | None
    """Where the frames of a correction come from."""
    scale: Scale | None
    """The standard deviations that residuals were weighed by."""
    set_aside: Records[SetAside]
    """Rows that a robust loss or a search set aside."""
    tool_refitted: Records[OwnBase]
    """Tools that were fitted to rows of their own."""


class IdentifyResult(ShownFit, AnyFit):
    """What an identification found; the version holds the same."""

    figures: Mapping[str, Figure]
    """Figures by name."""
    metrics: Metrics | None
    """Errors on the rows fitted and on those held out."""
    noise_mm: float | None
    """Standard deviation of a coordinate of the noise, mm."""
    null_directions: Records[NullDirection]
    """What the data could not tell."""
    objections: Records[Objection]
    """What it found against activating the version."""
    parameters: Records[Parameter]
    """Parameters that were identified."""
    version_id: str | None
    """Id of the version it made; None: none."""
    warnings: Records[Remark]
    """What to know before trusting the result."""


class Configuration(Record):
    """A configuration to read the inclinometer in."""

    axis: str | None
    """Axis of the joint's frame to read about."""
    joint: str | None
    """Name of the joint."""
    payload_com_mm: tuple[float, ...]
    """Its centre in the tool frame, mm; None: the tool point."""
    payload_kg: float | None
    """Load to carry, kg."""
    q_deg: tuple[float, ...]
    """All joints, degrees; mm for prismatic ones."""


class Motion(Record):
    """A motion of a joint, before and after what was found of it is taken off."""

    campaign: str | None
    """Id of the campaign."""
    left_deg: float | None
    """What is left of it, degrees."""
    raw_deg: float | None
    """Standard deviation of link minus motor angle, degrees."""
    use: str | None
    """`fitted` or `predicted`."""


class JointMotions(Record):
    """A joint with an encoder on its link side."""

    dead: str | None
    """Why its channel says nothing; None: it does."""
    joint: str
    """Name of the joint."""
    motions: Records[Motion]
    """Its motions, fitted and predicted."""


class JointParametersResult(ShownFit, Record):
    """What was measured of the joints, or where to read."""

    configurations: Records[Configuration]
    """Configurations to read."""
    csv: str | None
    """The configurations as a CSV file to fill in."""
    joint: str | None
    """The joint that configurations are proposed for."""
    joints: Records[JointMotions]
    """What link-side encoders say of each joint."""
    measured_by: str | None
    """`inclinometer` or `link-side encoder`."""
    objections: Records[Objection]
    """What it found against activating the version."""
    parameters: Records[Parameter]
    """Clearance, backlash and stiffness of the joints."""
    version_id: str | None
    """Id of the version it made; None: none."""
    warnings: Records[Remark]
    """What to know before trusting the result."""
