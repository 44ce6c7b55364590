"""What the server answers about checks, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records
from kilter_client.typed.fits import NullDirection
from kilter_client.typed.searches import Detectable, Untestable


class CheckedCampaign(Record):
    """A campaign that a job would use."""

    device: str
    """What it was measured with."""
    id: str
    """Id of the campaign."""
    name: str
    """Name of the campaign."""
    poses: int | None
    """Distinct poses among the rows; None: it cannot be read."""
    role: str
    """What it was measured for: `train`, `validation` or `confirmation`."""
    rows: int
    """Rows it has."""
    use: str
    """What this job takes it for."""


class Duration(Record):
    """How long the job would compute, in seconds, without waiting for other jobs."""

    basis: str
    """What this rests on: earlier jobs of this server, the job's own beginning, timed here, or a rule."""
    expected: float
    """Most likely, s."""
    high: float
    """Hardly more, s."""
    low: float
    """Hardly less, s."""


class HeldOut(Record):
    """What a job would not fit, but judge by."""

    how: str
    """`campaigns` named; a `fraction` of the poses; `folds`, every pose once; `unasked`: the quarter that a gap search holds out by itself; `none`."""
    poses: int
    """Distinct poses among them."""
    rows: int
    """Rows held out."""


class JobProblem(Record):
    """Why the job would fail."""

    code: str
    """Stable name of the error that the job would end with."""
    message: str
    """What is wrong, and what helps."""


class Missing(Record):
    """What the job would run without, and what that costs."""

    reason: str
    """Why it cannot be determined."""
    remedy: str
    """What to measure or to give."""
    what: str
    """What is missing, or not seen."""


class AnyCheck(Record):
    """What the check of every kind of job says."""

    campaigns: Records[CheckedCampaign]
    """Campaigns it would use, in the order given."""
    duration_s: Duration
    """How long it would compute, s."""
    held_out: HeldOut
    """What would be held out."""
    kind: str
    """Kind of the job."""
    limited: tuple[str, ...]
    """Where this check looked at less than the job would, in words."""
    missing: Records[Missing]
    """What it would run without."""
    poses: int
    """Distinct poses among those rows."""
    problems: Records[JobProblem]
    """Why it would fail; empty if it would run."""
    robot: str
    """Name of the robot."""
    rows: int
    """Rows of the campaigns it would learn from, held-out rows among them."""
    version: str | None
    """Id of the version it would start from; None: the nominal robot."""
    would_run: bool
    """Whether the job would run through, as far as can be predicted."""


class DriftCheck(AnyCheck):
    """What a check of an arm would do."""


class EvaluateCheck(AnyCheck):
    """What an evaluation would do."""


class Testability(Record):
    """What a gap search could test, judged with the geometry fitted and nothing named."""

    not_testable: Records[Untestable]
    """Effects that cannot be tested, with what would help."""
    testable: Records[Detectable]
    """Parameters that can be tested, with the smallest amplitude seen."""


class GapCheck(AnyCheck):
    """What a gap search would do."""

    testability: Testability | None
    """What could be tested; None: see `problems`."""


class UnknownParameter(Record):
    """A parameter that the poses do not tell."""

    name: str
    """Name of the parameter."""
    reason: str
    """Why, in words."""
    remedy: str
    """What would tell it; tried on the model, under these conditions."""


class Identifiability(Record):
    """What the poses tell of the parameters, by the Jacobian at the start of the fit."""

    identifiable: tuple[str, ...]
    """Names of the parameters that the poses tell."""
    noise_from: str
    """Where it comes from: `noise_mm`, repeats of poses, or `assumed` without either."""
    noise_mm: float
    """Standard deviation of a coordinate this was judged with, mm."""
    not_identifiable: Records[UnknownParameter]
    """The others, with what would tell them."""
    null_directions: Records[NullDirection]
    """Combinations that the poses cannot tell."""
    parameters: int
    """How many parameters would be identified."""
    rank: int
    """How many independent combinations of them the poses see at all."""


class IdentifyCheck(AnyCheck):
    """What an identification would do."""

    identifiability: Identifiability | None
    """What the poses tell of the parameters; None: see `problems`."""


class JointParametersCheck(AnyCheck):
    """What a measurement of joints would do."""


class PlanCheck(AnyCheck):
    """What a plan of poses would do."""


class RezeroCheck(AnyCheck):
    """What a re-zeroing would do."""
