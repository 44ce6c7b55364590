"""Verbs that compute: each asks for a job, follows it, and returns what it found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeAlias, Unpack, cast

from kilter_client import typed
from kilter_client.files import files_rig
from kilter_client.requests.calls import jobs as calls
from kilter_client.requests.steps import Document, Steps
from kilter_client.results.record import Record, Records
from kilter_client.typed.names import JOBS, MODULE_OF
from kilter_client.verbs.inputs import ResourceReference, reference, references
from kilter_client.verbs.progress import Watching, show_progress

# A share of the poses, campaigns, or {"folds": 5}.
HeldOut: TypeAlias = "float | ResourceReference | Sequence[ResourceReference] | Mapping[str, int] | None"
LISTS = (
    "effects",
    "free",
    "fix",
    "refit",
    "criteria",
    "causes",
    "new_setup",
)  # options of which one may be given without brackets
VERSIONS = ("start", "version")


def identify(
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference],
    *,
    validation: HeldOut = None,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[typed.options.IdentifyOptions],
) -> Steps[typed.identifications.IdentifyResult]:
    """Identify a robot's parameters from campaigns; the result names a new version.

    Args:
        robot: name of the robot.
        campaigns: what to fit to: results of ``upload``, names, ids, ``"latest"``.
        validation: what to hold out: a share of the poses (0.3), campaigns, or ``{"folds": 5}``.
        name: name of the job and of the version.
        progress: True for a bar, False for none, or a function of the fraction done and the stage.
        timeout_s: seconds to wait at most; the job continues.
        options: the options of the job by name, as ``level=2``, ``effects=["backlash"]``.

    Raises:
        OptionError: an option that does not exist or does not fit.
        JobFailedError: the job ended without a result; JobTimeoutError: it continues.

    """
    wanted = request_body("identify", robot, campaigns, options, validation, name)
    return cast("typed.identifications.IdentifyResult", (yield from run(wanted, progress, timeout_s)))


def gap(
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference],
    *,
    validation: HeldOut = None,
    confirmation: ResourceReference | Sequence[ResourceReference] = (),
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[typed.options.GapOptions],
) -> Steps[typed.searches.GapResult]:
    """Find where the model is wrong, name what is missing, and show how the gap shrinks on rows never used.

    ``confirmation`` are campaigns of another day or set-up in which it must see again what it found. The rest is as in
    ``identify``.

    Raises:
        OptionError: an option that does not exist or does not fit.
        JobFailedError: the job ended without a result; JobTimeoutError: it continues.

    """
    wanted = request_body("gap", robot, campaigns, options, validation, name, confirmation)
    return cast("typed.searches.GapResult", (yield from run(wanted, progress, timeout_s)))


def evaluate(
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference],
    *,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[typed.options.EvaluateOptions],
) -> Steps[typed.evaluations.EvaluateResult]:
    """Compare a version with campaigns: errors in mm and degrees, or the criteria of ISO 9283.

    Without ``version`` it is the active one, else the nominal robot.

    Raises:
        OptionError: an option that does not exist or does not fit.
        JobFailedError: the job ended without a result; JobTimeoutError: it continues.

    """
    wanted = request_body("evaluate", robot, campaigns, options, None, name)
    return cast("typed.evaluations.EvaluateResult", (yield from run(wanted, progress, timeout_s)))


def plan(
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference] = (),
    *,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[typed.options.PlanOptions],
) -> Steps[typed.plans.PlanResult]:
    """Plan poses to measure: for ISO 9283, to identify well, or to distinguish two effects.

    Raises:
        OptionError: an option that does not exist or does not fit.
        JobFailedError: the job ended without a result; JobTimeoutError: it continues.

    """
    wanted = request_body("plan", robot, campaigns, options, None, name)
    return cast("typed.plans.PlanResult", (yield from run(wanted, progress, timeout_s)))


def joint_parameters(
    robot: ResourceReference,
    readings_file: str | PathLike[str] | None = None,
    *,
    campaigns: ResourceReference | Sequence[ResourceReference] = (),
    validation: HeldOut = None,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[typed.options.JointParametersOptions],
) -> Steps[typed.identifications.JointParametersResult]:
    """Measure clearance, backlash and stiffness of joints directly, or say with ``propose`` where to read for that.

    ``readings_file`` is a CSV file of inclinometer readings, in deg; ``campaigns`` have link-side encoders.

    Raises:
        FileError: the file is not what it should be.
        OptionError: an option that does not exist or does not fit.
        JobFailedError: the job ended without a result; JobTimeoutError: it continues.

    """
    chosen: dict[str, Any] = dict(options)
    if readings_file is not None:
        chosen["readings"] = files_rig.read_readings(Path(fspath(readings_file)))
    wanted = request_body("joint_parameters", robot, campaigns, chosen, validation, name)
    return cast("typed.identifications.JointParametersResult", (yield from run(wanted, progress, timeout_s)))


def make_job_verb(kind: str) -> Callable[..., Steps[Record]]:
    """Return the verb of a kind of job for which none is written here."""

    def verb(
        robot: ResourceReference,
        campaigns: ResourceReference | Sequence[ResourceReference] = (),
        *,
        validation: HeldOut = None,
        confirmation: ResourceReference | Sequence[ResourceReference] = (),
        name: str = "",
        progress: Watching = True,
        timeout_s: float | None = None,
        **options: Any,
    ) -> Steps[Record]:
        wanted = request_body(kind, robot, campaigns, options, validation, name, confirmation)
        return (yield from run(wanted, progress, timeout_s))

    verb.__name__ = kind
    verb.__doc__ = f"""Ask for a job of kind ``{kind}``, follow it, and return its result; the rest is as in ``identify``.

    Raises:
        OptionError: an option that does not exist or does not fit.
        JobFailedError: the job ended without a result; JobTimeoutError: it continues.

    """
    return verb


def make_missing_verbs(client: type) -> dict[str, Callable[..., Steps[Record]]]:
    """Return a verb for each kind of job that a client has none for, by name."""
    return {kind: make_job_verb(kind) for kind in JOBS if not hasattr(client, kind)}


def submit(
    kind: str,
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference] = (),
    *,
    validation: HeldOut = None,
    confirmation: ResourceReference | Sequence[ResourceReference] = (),
    name: str = "",
    **options: Any,
) -> Steps[Record]:
    """Submit a job without waiting for it: ``"identify"``, ``"gap"``, ``"evaluate"``, ``"plan"`` ...

    Returns the job, still queued; ``wait`` follows it. The rest is as in the verb of the kind.

    Raises:
        OptionError: an option that does not exist or does not fit.

    """
    wanted = request_body(kind, robot, campaigns, options, validation, name, confirmation)
    return _read((yield from calls.submit(str(wanted["robot"]), wanted)))


def check(
    kind: str,
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference] = (),
    *,
    validation: HeldOut = None,
    confirmation: ResourceReference | Sequence[ResourceReference] = (),
    **options: Any,
) -> Steps[Record]:
    """Say at once what a job would do, and start nothing: what it uses and holds out, what is missing, how long it takes.

    The arguments are those of ``submit``. For ``"identify"`` also what the poses can determine, for ``"gap"`` which
    effects can be tested.

    Raises:
        OptionError: an option that does not exist or does not fit.

    """
    wanted = request_body(kind, robot, campaigns, options, validation, "", confirmation)
    told = yield from calls.check(str(wanted["robot"]), wanted)
    found: type[Record] = getattr(import_module("kilter_client.typed.checks"), f"{JOBS[kind].removesuffix('Job')}Check")
    return found.read(told)


def wait(
    job: ResourceReference, *, robot: str | None = None, progress: Watching = True, timeout_s: float | None = None
) -> Steps[Record]:
    """Follow a job to its end and return its result, as the verb of its kind does.

    Raises:
        JobFailedError: it ended without a result; JobCancelledError: it was cancelled; JobTimeoutError: it continues.

    """
    return (yield from _wait_for_job(reference("job", job), robot, progress, timeout_s))


def job(job: ResourceReference, *, robot: str | None = None) -> Steps[Record]:
    """Return a job: its state, its request, and its result if there is one.

    Raises:
        NotFoundError: there is none.

    """
    return _read((yield from calls.fetch_document(reference("job", job), robot)))


def jobs(robot: ResourceReference | None = None, *, limit: int = 100) -> Steps[Records[typed.server.JobSummary]]:
    """Return the newest jobs, of one robot or of all."""
    found = yield from calls.list_jobs(None if robot is None else reference("robot", robot), limit)
    return Records(typed.server.JobSummary, [typed.server.JobSummary.read(one) for one in found])


def cancel(job: ResourceReference, *, robot: str | None = None) -> Steps[Record]:
    """Ask a job to stop.

    Raises:
        NotFoundError: there is none.

    """
    return _read((yield from calls.cancel(reference("job", job), robot)))


def request_body(
    kind: str,
    robot: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference],
    options: Mapping[str, Any],
    validation: HeldOut,
    name: str,
    confirmation: ResourceReference | Sequence[ResourceReference] = (),
) -> Document:
    """Return the request for a job."""
    held_out = references("campaign", validation) if _names_campaigns(validation) else validation  # type: ignore[arg-type]
    chosen = {key: _option(key, value) for key, value in options.items()}
    used, again = references("campaign", campaigns), references("campaign", confirmation)
    return calls.request_body(kind, reference("robot", robot), used, held_out, chosen, again, name)


def _names_campaigns(validation: HeldOut) -> bool:
    return isinstance(validation, str | Record) or (
        isinstance(validation, Sequence) and not isinstance(validation, Mapping)
    )


def _option(name: str, value: Any) -> Any:
    """Return an option as JSON has it: a lone value in brackets where several may be given, arrays as lists."""
    if name in LISTS and isinstance(value, str):
        return [value]
    if name in VERSIONS and isinstance(value, Record):
        return reference("version", value)
    if hasattr(value, "tolist"):
        return value.tolist()
    return value


def run(wanted: Document, progress: Watching, timeout_s: float | None) -> Steps[Record]:
    """Submit a job, follow it to its end, and return its result."""
    job = yield from calls.submit(str(wanted["robot"]), wanted)
    return (yield from _wait_for_job(str(job["id"]), None, progress, timeout_s, f"{wanted['kind']} {wanted['robot']}"))


def _wait_for_job(
    job_id: str, robot: str | None, progress: Watching, timeout_s: float | None, label: str = ""
) -> Steps[Record]:
    with show_progress(progress, label or job_id) as told:
        done = _read((yield from calls.wait(job_id, told, timeout_s, robot)))
    result: Record = getattr(done, "result", None) or done
    object.__setattr__(result, "_job", done)
    return result


def _read(document: Document) -> Record:
    """Read a job by its kind; one of a kind that this release does not know keeps its document."""
    name = JOBS.get(str(document.get("kind")))
    if name is None:
        return Record.read(document)
    found: Record = getattr(import_module(f"kilter_client.typed.{MODULE_OF[name]}"), name).read(document)
    return found
