"""What an upload would store, and what would be refused of it: nothing is stored."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

from kilter_client.errors import ApiError, CalibrationError, ConflictError, KilterError, NotFoundError, PayloadError
from kilter_client.files import files_look
from kilter_client.requests.calls import campaigns, robots
from kilter_client.requests.steps import Document, Steps
from kilter_client.results.corrected import DryRun
from kilter_client.verbs.campaigns import build_conditions, find_stored_campaign
from kilter_client.verbs.inputs import Data, ResourceReference, default_name, prepare_rows, reference
from kilter_client.verbs.servo_calibration import compare_calibration_file

if TYPE_CHECKING:
    from kilter_client.results.corrected import DryRun
    from kilter_files import Prepared

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
        done = yield from campaigns.check(robot, prepared, wanted if into is None else None, into)
    except ApiError as error:
        if not _knows_rows_alone(error):
            raise
        done = yield from campaigns.check(robot, prepared)
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
