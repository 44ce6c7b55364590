"""Verbs about measurements.

What an upload would store, and what would be refused of it: nothing is stored.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, Literal

from kilter_client import typed
from kilter_client.errors import (
    ApiError,
    CalibrationError,
    ConflictError,
    KilterError,
    NotFoundError,
    ObservationError,
    PayloadError,
    UsageError,
)
from kilter_client.files import files_look
from kilter_client.requests.calls import campaigns as calls
from kilter_client.requests.calls import campaigns as campaign_calls
from kilter_client.requests.calls import robots
from kilter_client.requests.calls.references import resolve_id
from kilter_client.requests.steps import Document, Sent, Steps
from kilter_client.resources import is_same_campaign
from kilter_client.results.corrected import DryRun
from kilter_client.results.record import Records
from kilter_client.verbs.inputs import (
    Data,
    ResourceReference,
    default_name,
    parse_day,
    parse_time,
    prepare_rows,
    reference,
)
from kilter_client.verbs.progress import Watching, show_progress
from kilter_client.verbs.servo_calibration import compare_calibration_file

if TYPE_CHECKING:
    from datetime import date, datetime

    from kilter_client.results.corrected import DryRun
    from kilter_files import Prepared


MOST_LINES = 8  # of a file that are named in a refusal


def upload(
    robot: ResourceReference,
    data: Data,
    *,
    columns: Sequence[str] | None = None,
    name: str | None = None,
    role: Literal["train", "validation", "confirmation"] = "train",
    device: str | None = None,
    column_map: str | PathLike[str] | None = None,
    preset: str | None = None,
    euler: str | None = None,
    joints: str | PathLike[str] | None = None,
    payload_kg: float | None = None,
    payload_com_mm: Sequence[float] | None = None,
    temperature_c: float | None = None,
    tool_force_n: Sequence[float] | None = None,
    tool_moment_nm: Sequence[float] | None = None,
    calibration: str | PathLike[str] | None = None,
    notes: str = "",
    measured_at: datetime | date | str | None = None,
    instrument: str | None = None,
    campaign: ResourceReference | None = None,
    progress: Watching = True,
) -> Steps[typed.campaigns.Uploaded]:
    """Upload measurements as a campaign of a robot; the same rows again change nothing.

    Args:
        robot: name of the robot.
        data: a path; or columns by name (``{"q1_deg": ..., "x_mm": ...}``), a structured array, a pandas DataFrame.
        columns: names of the columns of an array of two dimensions, with units.
        name: name of the campaign; without one it is the file's, with a number added where that is taken.
        role: what the rows are for.
        device: the measuring device; files of some devices are converted.
        column_map: column map of a lab's own file.
        preset: program whose text export of points it is (``"leica"``, ...).
        euler: order of the preset's angles.
        joints: file with the joints of the preset's points, in order; or the second file of a map with a [join].
        payload_kg: mass at the tool point during the campaign, kg.
        payload_com_mm: its centre in the tool frame, mm.
        temperature_c: temperature of the arm, degrees Celsius.
        tool_force_n: force on the tool point in its frame, N.
        tool_moment_nm: moment on the tool point in its frame, N m.
        calibration: LeRobot's calibration of the servos that read the joints; it is compared with robot and rows.
        notes: anything else worth knowing.
        measured_at: when the last row was measured, as ``"2026-11-02T14:30"``, in this machine's zone where none is given.
        instrument: name of the instrument it was measured with (``k.add_instrument``).
        campaign: add to this campaign instead of making one.
        progress: True for a bar, False for none, or a function of the fraction sent and the stage.

    Raises:
        FileError: the file is not what it should be.
        UsageError: the data are not rows, or ``campaign`` is given with what it has already.
        ObservationError: the rows are not what their columns say; nothing is stored.

    """
    conditions = build_conditions(
        payload_kg=payload_kg,
        payload_com_mm=payload_com_mm,
        temperature_c=temperature_c,
        tool_force_n=tool_force_n,
        tool_moment_nm=tool_moment_nm,
    )
    if campaign is not None and (name or notes or conditions or measured_at or instrument or calibration):
        raise UsageError("campaign= adds to a campaign that has its name, notes and conditions already.")
    device_name = device or preset or ""
    wanted: Document = {"name": name or default_name(data), "device": device_name, "role": role, "notes": notes}
    prepared = prepare_rows(data, columns, device, column_map, preset, euler, joints)
    file, arm = fspath(data) if isinstance(data, str | PathLike) else wanted["name"], reference("robot", robot)
    servos, prepared = yield from compare_calibration_file(arm, calibration, prepared, file)
    wanted |= {"conditions": conditions | servos, "numbered": name is None, "measured_at": parse_time(measured_at)}
    into = None if campaign is None else (yield from resolve_id("campaign", reference("campaign", campaign), arm))
    done = yield from _send_with_progress(arm, into, wanted | {"instrument": instrument}, prepared, file, progress)
    return typed.campaigns.Uploaded.read(done)


def build_conditions(**told: Any) -> dict[str, Any]:
    """What holds for the whole campaign; numbers and lists as JSON has them."""
    given = {key: value for key, value in told.items() if value is not None}
    return {key: [float(one) for one in v] if hasattr(v, "__len__") else float(v) for key, v in given.items()}


def _send_with_progress(
    robot: str, into: str | None, wanted: Mapping[str, Any], prepared: Prepared, file: str, progress: Watching
) -> Steps[Document]:
    """Send, and show how far it is."""
    with show_progress(progress, f"sending {wanted['name']}") as bar:
        sent: Sent | None = None if bar is None else lambda some, total: bar(some / max(total, 1), "sending")
        return (yield from send_rows(robot, into, wanted, prepared, file, sent))


def send_rows(
    robot: str,
    into: str | None,
    wanted: Mapping[str, Any],
    prepared: Prepared,
    file: str,
    sent: Sent | None,
    begun: Callable[[tuple[str, bool]], None] = lambda target: None,
) -> Steps[Document]:
    """Send to a campaign, to the one that has these rows already, or to a new one, seen when the rows are in it.

    ``into`` is the id of a campaign that is there; ``file`` is the person's own. ``begun`` is told the campaign and whether it
    is a new one, before the first row is sent.

    Raises:
        ObservationError: the rows are not what their columns say; nothing is stored. Lines of ``file`` are named.

    """
    try:
        into = into or (yield from find_stored_campaign(robot, wanted, prepared))
        if into is not None:
            begun((into, False))
            return (yield from calls.send(into, prepared, sent))
        made = yield from calls.add(robot, {**wanted, "staged": True})
        target = str(made["id"])
        begun((target, True))
        try:
            done = yield from calls.send(target, prepared, sent)
        except ApiError:
            yield from calls.discard(target)
            raise
        yield from calls.commit(target, [str(done["sha256"])])
    except ObservationError as error:
        raise _add_line_numbers(error, prepared, file) from error
    return done


def find_stored_campaign(robot: str, wanted: Mapping[str, Any], prepared: Prepared) -> Steps[str | None]:
    """Return the id of the campaign that has these rows already, as they are wanted; the last of several."""
    found = None
    for known in (yield from calls.list_campaigns(robot)):
        if is_same_campaign(known, wanted) and any(done["sha256"] == prepared.sha256 for done in known["uploads"]):
            found = str(known["id"])
    return found


def _add_line_numbers(error: ObservationError, prepared: Prepared, file: str) -> ObservationError:
    """Add on which lines of the person's own file the refused rows stand."""
    named = error.context.get("rows")  # of a mix-up it is how many
    rows = [k for k in (named if isinstance(named, list) else [error.context.get("row")]) if isinstance(k, int)]
    lines = [prepared.lines[k - 1] for k in rows if 0 < k <= len(prepared.lines)]
    if lines:
        error.context |= {"file": file, "line": lines[0], "lines": lines}
        more = " ..." if len(lines) > MOST_LINES else ""
        error.detail += f" That is line {', '.join(map(str, lines[:MOST_LINES]))}{more} of {file}."
        error.args = (error.detail,)
    return error


def campaign(campaign: ResourceReference, *, robot: str | None = None) -> Steps[typed.campaigns.Campaign]:
    """Return a campaign: its rows, role, conditions and uploads.

    Raises:
        NotFoundError: there is none; ConflictError: the name is ambiguous.

    """
    return typed.campaigns.Campaign.read((yield from calls.fetch_document(reference("campaign", campaign), robot)))


def suspicious(campaign: ResourceReference, *, robot: str | None = None) -> Steps[typed.others.SuspiciousRows]:
    """Return the rows of a campaign that look wrong: by how many mm and standard deviations, and who says so.

    Raises:
        NotFoundError: there is none; ConflictError: the name is ambiguous.

    """
    return typed.others.SuspiciousRows.read((yield from calls.suspicious(reference("campaign", campaign), robot)))


def campaigns(robot: ResourceReference, *, retired: bool = False) -> Steps[Records[typed.campaigns.Campaign]]:
    """Return the campaigns of a robot, oldest first; with ``retired`` also those that are out of use."""
    found = yield from calls.list_campaigns(reference("robot", robot), retired=retired)
    return Records(typed.campaigns.Campaign, [typed.campaigns.Campaign.read(one) for one in found])


Kind = Literal["laser_tracker", "arm_cmm", "cmm", "camera", "ball_bar", "other"]
Standard = Literal["iso_10360_10", "iso_10360_12", "other"]


def add_instrument(
    name: str,
    kind: Kind,
    serial_number: str,
    *,
    mpe_um: float,
    mpe_um_per_m: float = 0.0,
    mpe_standard: Standard = "other",
    certificate: str = "",
    certified_on: date | str | None = None,
    valid_until: date | str | None = None,
    notes: str = "",
) -> Steps[typed.campaigns.Instrument]:
    """Add an instrument with its maximum permissible error and its certificate; the same one twice changes nothing.

    With its next certificate it is added under another name: what was measured before keeps the certificate of then.

    Args:
        name: name to give it, as ``"tracker-2026"``.
        kind: ``"laser_tracker"``, ``"arm_cmm"`` (an articulated arm), ``"cmm"``, ``"camera"``, ``"ball_bar"`` or ``"other"``.
        serial_number: as on its plate.
        mpe_um: permissible error at length 0, micrometres: A of A + B L.
        mpe_um_per_m: what it grows by per length, micrometres per metre: B of A + B L.
        mpe_standard: what states it: ``"iso_10360_10"`` (trackers), ``"iso_10360_12"`` (articulated arms) or ``"other"``.
        certificate: number of the calibration certificate.
        certified_on: day of the certificate, as ``"2026-01-10"``.
        valid_until: last day on which it holds.
        notes: anything else worth knowing.

    Raises:
        UsageError: a day that is none; ConflictError: another instrument has that name.

    """
    wanted = {
        "name": name,
        "kind": kind,
        "serial_number": serial_number,
        "mpe_standard": mpe_standard,
        "mpe_um": mpe_um,
        "mpe_um_per_m": mpe_um_per_m,
        "certificate": certificate,
        "certified_on": parse_day(certified_on),
        "valid_until": parse_day(valid_until),
        "notes": notes,
    }
    return typed.campaigns.Instrument.read((yield from calls.add_instrument(wanted)))


def instruments() -> Steps[Records[typed.campaigns.Instrument]]:
    """Return the instruments by name, with permissible errors in um and um/m, and their certificates."""
    return Records(
        typed.campaigns.Instrument,
        [typed.campaigns.Instrument.read(one) for one in (yield from calls.list_instruments())],
    )


PIXEL = re.compile(r"[uv]\d+_px")
REFUSALS = (CalibrationError, ConflictError, NotFoundError, PayloadError)  # that an upload would meet, too


def dry_run(
    robot: ResourceReference,
    data: Data,
    *,
    columns: Sequence[str] | None = None,
    device: str | None = None,
    column_map: str | PathLike[str] | None = None,
    preset: str | None = None,
    euler: str | None = None,
    joints: str | PathLike[str] | None = None,
    payload_kg: float | None = None,
    payload_com_mm: Sequence[float] | None = None,
    temperature_c: float | None = None,
    tool_force_n: Sequence[float] | None = None,
    tool_moment_nm: Sequence[float] | None = None,
    calibration: str | PathLike[str] | None = None,
) -> Steps[DryRun]:
    """Show what ``upload`` would store with the same arguments, and what would be refused; store nothing.

    Where the server does not answer, ``not_checked`` says what it would have checked.

    Raises:
        FileError: the file is not what it should be; UsageError: the data are not rows.

    """
    conditions = build_conditions(
        payload_kg=payload_kg,
        payload_com_mm=payload_com_mm,
        temperature_c=temperature_c,
        tool_force_n=tool_force_n,
        tool_moment_nm=tool_moment_nm,
    )
    prepared = prepare_rows(data, columns, device, column_map, preset, euler, joints)
    file, arm = fspath(data) if isinstance(data, str | PathLike) else default_name(data), reference("robot", robot)
    servos, prepared = yield from compare_calibration_file(arm, calibration, prepared, file)
    wanted = {
        "name": default_name(data),
        "numbered": True,
        "device": device or preset or "",
        "conditions": conditions | servos,
    }
    found = yield from checked_rows(arm, prepared, wanted)
    told = {"columns": prepared.columns, "notes": prepared.notes, "warnings": prepared.warnings}
    return DryRun.read(told | {"rows": prepared.rows} | found)


def checked_rows(
    robot: str,
    prepared: Prepared,
    wanted: Mapping[str, Any],
    into: str | None = None,
    worded: Callable[[str], str] = str,
) -> Steps[Document]:
    """Return ranges, poses, repeats, loads, directions, and what would be refused, here and by the server.

    ``wanted`` is the campaign that an upload would make; ``into`` is the id of the one that it would add to instead.
    ``worded`` says a refusal of the server in the words of whoever asked.
    """
    conditions = wanted.get("conditions") or {}
    try:
        known = list((yield from robots.fetch_document(robot))["joints"])
    except KilterError as error:
        return checked_here(prepared, conditions, error)
    found = checked_here(prepared, conditions, None, known)
    try:
        odd, unknown = yield from _by_server(robot, prepared, wanted, into)
    except REFUSALS as error:
        # Readings outside the limits are named here row by row; a mix-up that explains them says more.
        limits = error.code == "observations_invalid" and found["refused"]
        return found | {"refused": found["refused"] if limits else [worded(error.detail)]}
    except KilterError as error:
        return found | {"not_checked": f"whether the rows belong to the robot ({error.detail.rstrip('.')})"}
    return found | {"refused": [], "odd": [one["message"] for one in odd], "not_checked": unknown}


def _by_server(
    robot: str, prepared: Prepared, wanted: Mapping[str, Any], into: str | None
) -> Steps[tuple[list[Document], str]]:
    """What the server finds odd in rows that it would store, and what it did not look at."""
    into = into or (yield from find_stored_campaign(robot, wanted, prepared))
    try:
        done = yield from campaign_calls.check(robot, prepared, wanted if into is None else None, into)
    except ApiError as error:
        if not _knows_rows_alone(error):
            raise
        done = yield from campaign_calls.check(robot, prepared)
        return list(done.get("warnings", ())), _left_to_upload(prepared, into)
    return list(done.get("warnings", ())), ""


def _knows_rows_alone(error: ApiError) -> bool:
    """Whether a server refused the question and not the rows: one that is older than this client checks rows alone."""
    if error.code == "media_type_unsupported":
        return True
    places = [one.get("place") for one in error.context.get("errors", ())]
    return error.code == "payload_invalid" and places == ["query.campaign"]


def _left_to_upload(prepared: Prepared, into: str | None) -> str:
    """What such a server looks at in an upload only."""
    parts = ["name", "conditions", "instrument"] if into is None else ["columns of the campaign"]
    if any(map(PIXEL.fullmatch, files_look.numeric_columns(prepared))):
        parts.append("what its cameras and boards can show")
    listed = ", ".join(parts[:-1]) + " and " if len(parts) > 1 else ""
    return f"{listed}{parts[-1]}, which this server looks at in an upload only, for it is older than this program"


def checked_here(
    prepared: Prepared, conditions: Mapping[str, Any], why: KilterError | None, joints: list[Document] | None = None
) -> Document:
    """Return what can be said without a server; ``why`` is the reason for which the robot's joints are not known."""
    unknown = (
        f"joints and their limits, and whether the rows belong to the robot ({why.detail.rstrip('.')})" if why else ""
    )
    return files_look.summary(prepared, conditions) | {
        "left_out": [text for text in prepared.warnings if "left out" in text],
        "refused": files_look.otherwise_separated(prepared)
        or files_look.refusals(files_look.numeric_columns(prepared), joints, prepared.lines),
        "odd": [],
        "not_checked": unknown,
    }
