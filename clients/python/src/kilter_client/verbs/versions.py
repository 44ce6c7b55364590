"""Verbs about versions and corrections.

Verbs that name, note, retire, restore and purge.

The verb that asks whether an arm has moved: it sends some poses and checks them against the version that corrects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, cast

from kilter_client import typed
from kilter_client.errors import UsageError
from kilter_client.requests.calls import references as reference_calls
from kilter_client.requests.calls import robots as robot_calls
from kilter_client.requests.calls import versions as calls
from kilter_client.requests.calls.references import Kind
from kilter_client.requests.steps import Answer, Document, Steps
from kilter_client.results.corrected import Corrected
from kilter_client.results.record import Record, Records
from kilter_client.results.rows import Rows, write_file
from kilter_client.verbs import campaigns, jobs
from kilter_client.verbs.inputs import Data, ResourceReference, What, infer_kind, prepare_rows, reference, references
from kilter_client.verbs.progress import Watching

if TYPE_CHECKING:
    from datetime import date, datetime

    from kilter_client.requests.calls.versions import Exported
    from kilter_client.results.corrected import Corrected
    from kilter_client.results.rows import Rows
    from kilter_client.typed.drifts import DriftResult, RezeroResult
    from kilter_client.typed.options import DriftOptions, RezeroOptions


def version(version: ResourceReference, *, robot: str | None = None) -> Steps[typed.versions.Version]:
    """Return a version: its parameters with nominal, value and sigma, its errors in mm, what it was made from.

    Raises:
        NotFoundError: there is none; ConflictError: the name is ambiguous.

    """
    return typed.versions.Version.read((yield from calls.fetch_document(reference("version", version), robot)))


def versions(robot: ResourceReference, *, retired: bool = False) -> Steps[Records[typed.versions.VersionSummary]]:
    """Return the versions of a robot, newest first; with ``retired`` also those that are out of use."""
    found = yield from calls.list_versions(reference("robot", robot), retired)
    return Records(typed.versions.VersionSummary, [typed.versions.VersionSummary.read(one) for one in found])


def activate(
    version: ResourceReference, *, robot: str | None = None, force: bool = False, reason: str = ""
) -> Steps[typed.versions.ActivatedVersion]:
    """Make a version the one that corrects, unless it predicts worse than the active one.

    ``force`` activates it nevertheless; the log records this and the ``reason``.

    Raises:
        NotFoundError: there is no such version.
        ConflictError: it predicts worse, or is retired.

    """
    return typed.versions.ActivatedVersion.read(
        (yield from calls.activate(reference("version", version), force=force, reason=reason, robot=robot))
    )


def rollback(robot: ResourceReference) -> Steps[typed.versions.ActivatedVersion]:
    """Return to the version that was active before.

    Raises:
        ConflictError: there was none.

    """
    return typed.versions.ActivatedVersion.read((yield from calls.rollback(reference("robot", robot))))


def activations(robot: ResourceReference) -> Steps[Records[typed.versions.Activation]]:
    """Return who activated which version, when and why, newest first."""
    found = yield from calls.activations(reference("robot", robot))
    return Records(typed.versions.Activation, [typed.versions.Activation.read(one) for one in found])


def preview(version: ResourceReference, *, robot: str | None = None) -> Steps[typed.previews.VersionPreview]:
    """Return how a version would correct: the largest correction in mm and where, and which poses it would refuse."""
    return typed.previews.VersionPreview.read((yield from calls.preview(reference("version", version), robot)))


def diff(
    first: ResourceReference, second: ResourceReference, *, robot: str | None = None
) -> Steps[typed.comparisons.VersionDiff]:
    """Compare two versions, parameter by parameter; ``"nominal"`` is the nominal robot.

    Raises:
        NotFoundError: there is no such version.

    """
    one, other = reference("version", first), reference("version", second)
    return typed.comparisons.VersionDiff.read((yield from calls.diff(one, other, robot)))


def residuals(
    version: ResourceReference,
    campaigns: ResourceReference | Sequence[ResourceReference] = (),
    *,
    robot: str | None = None,
) -> Steps[Rows]:
    """Return the residuals of every row, mm: of these campaigns, or of all its own.

    Raises:
        NotFoundError: there is no such version or campaign.

    """
    used = references("campaign", campaigns)
    return Rows((yield from calls.residuals(reference("version", version), used, "csv", robot)))


def export(
    version: ResourceReference,
    form: str = "json",
    *,
    robot: str | None = None,
    path: str | Path | None = None,
    ranges_percent: float | None = None,
) -> Steps[Exported]:
    """Return a version as a file (``"json"``, ``"urdf"``, ``"dh-csv"``, ...), and write it to ``path`` if one is given.

    Its ``notes`` say what the file leaves out. ``"ranges"`` is how far the arm may be from the version, to train with;
    the ranges cover ``ranges_percent``, by default 95.

    Raises:
        OptionError: there is no such format; FileError: the file cannot be written.

    """
    content = yield from calls.export(reference("version", version), form, robot, ranges_percent)
    if path is not None:
        write_file(content, path)
    return content


def correct(
    robot: ResourceReference,
    trajectory: Data,
    *,
    columns: Sequence[str] | None = None,
    version: ResourceReference | None = None,
    form: str | None = None,
    payload_kg: float | None = None,
    payload_com_mm: Sequence[float] | None = None,
    task: str | None = None,
    strict: bool = False,
    at_limit: str | None = None,
    hold: Sequence[int] | None = None,
) -> Steps[Corrected]:
    """Correct a trajectory with the active version, or with ``version``.

    The answer has the format that was sent, CSV for arrays; ``form="ros2-yaml"`` asks for a ROS 2 JointTrajectory. Its
    ``left_mm`` is what the correction leaves of each row; ``status`` is ``OK`` where that is within what is stated.

    Args:
        robot: name of the robot.
        trajectory: a path; or columns by name (``{"t_s": ..., "q1_deg": ...}``), a structured array, a pandas DataFrame.
        columns: names of the columns of an array of two dimensions, with units.
        version: another version than the active one: id or its beginning, name, or ``"latest"``.
        form: another format than the one sent.
        payload_kg: mass on the tool along the whole path, kg.
        payload_com_mm: its centre in the tool frame, mm.
        task: ``"position"`` holds the position first, as by default; ``"pose"`` position and orientation alike.
        at_limit: ``"saturate"`` holds a correction at the version's limits, as by default; ``"refuse"`` refuses the row.
        hold: joints, from 1, that the correction leaves as they are, such as a rail; default: those of the version.
        strict: refuse the trajectory unless every row is corrected to within what is stated.

    Raises:
        ConflictError: the robot has no active version; or ``strict``, and a row is not.
        ObservationError: the rows are not what their columns say.
        FileError, UsageError: the trajectory is neither such a file nor rows.

    """
    chosen = None if not version else reference("version", version)
    answer = yield from calls.correct(
        reference("robot", robot),
        prepare_rows(trajectory, columns),
        chosen,
        form,
        payload_kg,
        payload_com_mm,
        task=task,
        strict=strict,
        at_limit=at_limit,
        hold=hold,
    )
    return _answered_path(answer)


def torques(
    robot: ResourceReference,
    path: Data,
    *,
    columns: Sequence[str] | None = None,
    search: ResourceReference | None = None,
    version: ResourceReference | None = None,
    payload_kg: float | None = None,
    payload_com_mm: Sequence[float] | None = None,
) -> Steps[Corrected]:
    """Return a path with the torques of gravity, inertia and friction along it, ``tau1_nm`` ..., by what a log of torques said.

    The answer has the format that was sent, CSV for arrays. ``notes`` names what it is by, and joints without a torque.

    Args:
        robot: name of the robot.
        path: a file; or columns by name (``{"t_s": ..., "q1_deg": ...}``), a structured array, a pandas DataFrame.
        columns: names of the columns of an array of two dimensions, with units.
        search: the search in torques to take: id or its beginning, or name.
        version: the version whose torques to take; default: the active one, and the newest search where that has none.
        payload_kg: mass on the tool along the whole path, kg.
        payload_com_mm: its centre in the tool frame, mm.

    Raises:
        ConflictError: the version holds no torques, or no log was searched.
        ObservationError: the rows are not what their columns say.
        FileError, UsageError: the path is neither such a file nor rows.

    """
    job = None if not search else reference("job", search)
    chosen = None if not version else reference("version", version)
    rows = prepare_rows(path, columns)
    return _answered_path(
        (yield from calls.torques(reference("robot", robot), rows, job, chosen, payload_kg, payload_com_mm))
    )


def _answered_path(answer: Answer) -> Corrected:
    path = Corrected(answer.content)
    path.media_type = answer.headers.get("content-type", "").partition(";")[0]
    path.left_out = tuple(filter(None, answer.headers.get("kilter-not-corrected", "").split(", ")))
    path.notes = calls.server_notes(answer)
    path.u95 = answer.headers.get("kilter-u95", "")
    return path


def change(
    thing: ResourceReference,
    *,
    name: str | None = None,
    notes: str | None = None,
    kind: What | None = None,
    robot: str | None = None,
) -> Steps[Record]:
    """Name a campaign or version, or add a note to it or to a robot; what is left out stays.

    Raises:
        UsageError: a name alone does not say what it is: give ``kind``.
        ConflictError: the name is taken.

    """
    what = infer_kind(thing, kind)
    called = reference(what, thing)
    if what != "robot":
        return _read(what, (yield from reference_calls.change(_require_keepable(what), called, name, notes, robot)))
    if name is not None:
        raise UsageError("A robot keeps the name it was added with: give notes= only.")
    return _read(what, (yield from robot_calls.note(called, notes or "")))


def retire(thing: ResourceReference, *, kind: What | None = None, robot: str | None = None) -> Steps[Record]:
    """Take a campaign, a version or a robot out of use; what cites it does not change.

    Raises:
        UsageError: a name alone does not say what it is: give ``kind``.
        ConflictError: it is active.

    """
    return (yield from _do("retire", thing, kind, robot))


def restore(thing: ResourceReference, *, kind: What | None = None, robot: str | None = None) -> Steps[Record]:
    """Bring a campaign, a version or a robot back into use.

    Raises:
        UsageError: a name alone does not say what it is: give ``kind``.

    """
    return (yield from _do("restore", thing, kind, robot))


def purge(thing: ResourceReference, *, kind: What | None = None) -> Steps[typed.comparisons.Tombstone]:
    """Delete a retired campaign, version or robot for good, by its full id; returns its tombstone: its hash, who, when.

    Raises:
        ConflictError: something cites it, or it is in use.

    """
    what = infer_kind(thing, kind)
    called = reference(what, thing)
    found = (
        yield from robot_calls.do(called, "purge")
        if what == "robot"
        else reference_calls.purge(_require_keepable(what), called)
    )
    return typed.comparisons.Tombstone.read(found)


def _do(doing: str, thing: ResourceReference, kind: What | None, robot: str | None) -> Steps[Record]:
    what = infer_kind(thing, kind)
    called = reference(what, thing)
    if what == "robot":
        return _read(what, (yield from robot_calls.do(called, doing)))
    return _read(what, (yield from reference_calls.do(_require_keepable(what), called, doing, robot)))


def _require_keepable(what: What) -> Kind:
    if what == "job":
        raise UsageError("Jobs are kept as they are: name, note, retire or purge the version that the job made.")
    return cast(Kind, what)


def _read(what: What, document: Document) -> Record:
    kinds: dict[str, Any] = {
        "campaign": typed.campaigns.Campaign,
        "version": typed.versions.Version,
        "robot": typed.robots.RobotReport,
    }
    found: Record = kinds[what].read(document)
    return found


def drift(
    robot: ResourceReference,
    data: Data | None = None,
    *,
    campaign: ResourceReference | None = None,
    device: str | None = None,
    column_map: str | PathLike[str] | None = None,
    payload_kg: float | None = None,
    temperature_c: float | None = None,
    measured_at: datetime | date | str | None = None,
    instrument: str | None = None,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[DriftOptions],
) -> Steps[DriftResult]:
    """Say whether an arm has moved since its version was made, and which one change explains it.

    The rows are stored as a campaign with the role ``validation``: no fit takes them unless it names them. Where
    they are refused, as of another arm or too few, the server retires them.

    Args:
        robot: name of the robot.
        data: rows of three poses or more, as ``upload`` takes them.
        campaign: a campaign that is stored already, instead of data.
        device: the measuring device; files of some devices are converted.
        column_map: column map of a lab's own file.
        payload_kg: mass at the tool point, kg.
        temperature_c: temperature of the arm, degrees Celsius.
        measured_at: when the last row was measured.
        instrument: name of the instrument that measured, as `instruments` lists them.
        name: name of the campaign and of the job.
        progress: True for a bar, False for none, or a function of the fraction done and the stage.
        timeout_s: seconds to wait at most; the job continues.
        options: the options of the job by name, as ``new_setup=["base"]``, ``noise_mm=0.05``.

    Raises:
        UsageError: neither data nor a campaign, or both.
        ObservationError: the rows are not what their columns say.
        JobFailedError: the check was refused, as for rows of another arm; JobTimeoutError: it continues.

    """
    if (data is None) == (campaign is None):
        raise UsageError("Give the rows to check with, or campaign= of rows that are stored.")
    if campaign is None:
        assert data is not None
        sent = yield from campaigns.upload(
            robot,
            data,
            name=name or None,
            role="validation",
            device=device,
            column_map=column_map,
            payload_kg=payload_kg,
            temperature_c=temperature_c,
            measured_at=measured_at,
            instrument=instrument,
            progress=progress,
        )
        asked = jobs.request_body("drift", robot, sent.campaign_id, options, None, name)
        return cast("DriftResult", (yield from jobs.run(asked, progress, timeout_s)))
    _refuse_known(
        {
            "device": device,
            "column_map": column_map,
            "payload_kg": payload_kg,
            "temperature_c": temperature_c,
            "measured_at": measured_at,
            "instrument": instrument,
        }
    )
    asked = jobs.request_body("drift", robot, reference("campaign", campaign), options, None, name)
    return cast("DriftResult", (yield from jobs.run(asked, progress, timeout_s)))


def rezero(
    robot: ResourceReference,
    campaign: ResourceReference = "latest",
    *,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[RezeroOptions],
) -> Steps[RezeroResult]:
    """Make a version of the one or few parameters that moved, by the rows of a check; activate it as any other.

    Without ``causes`` it is what a check of these rows names, if that is one cause.

    Raises:
        JobFailedError: the rows do not say which parameter moved; JobTimeoutError: it continues.

    """
    asked = jobs.request_body("rezero", robot, reference("campaign", campaign), options, None, name)
    return cast("RezeroResult", (yield from jobs.run(asked, progress, timeout_s)))


def _refuse_known(given: Mapping[str, Any]) -> None:
    named = [name for name, value in given.items() if value is not None]
    if named:
        raise UsageError(f"{named[0]}= belongs to rows that are sent: the campaign has its own.")
