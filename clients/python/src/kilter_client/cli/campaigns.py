"""``kilter upload`` and ``kilter campaigns``."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli import arguments, keeping
from kilter_client.cli.arguments import File, Json, PayloadCentre, Retired, Robot
from kilter_client.cli.checks import Unchecked
from kilter_client.cli.dry_run import show_dry_run, what_it_holds
from kilter_client.cli.inspect import JointOrder, Topic, check_numpy
from kilter_client.cli.interrupt import on_interrupt
from kilter_client.cli.match import joints_of
from kilter_client.cli.output import REMEDY_FOR_COLUMNS, emit, note, say
from kilter_client.cli.progress import upload_bar
from kilter_client.cli.references import resolved
from kilter_client.cli.tables import show_rows
from kilter_client.errors import ApiError, ConflictError, KilterError, ObservationError, UsageError
from kilter_client.given import moment_of
from kilter_client.naming import same
from kilter_files import DEVICES, Prepared, prepare
from kilter_files.formats.points.tracker_header import PRESETS
from kilter_files.tables.table import CSV_TYPE

A_MARKER = re.compile(rb"m[1-9]\d?[xyz]_")
SHOWN = 8  # lines of refused rows that are named in the sentence
Role = Literal["train", "validation", "confirmation"]
PresetName = Annotated[
    str | None,
    typer.Option("--preset", help=f"The file is a tracker's or CMM's text export of: {', '.join(PRESETS)}."),
]
Euler = Annotated[
    str | None, typer.Option(help="Preset: order of its angles, XYZ about the moving axes, xyz about the fixed ones.")
]
Joints = Annotated[
    Path | None,
    typer.Option(
        help="Preset: joints of the points, in order: CSV, a bag, a program. Map: its second file.",
        exists=True,
    ),
]


Device = Annotated[
    str | None, typer.Option(help=f"Measuring device; files of these are converted: {', '.join(DEVICES)}.")
]
IntoCampaign = Annotated[
    str | None,
    typer.Option("--campaign", metavar="ID", help="Add to this campaign (id, name or `latest`) instead of making one."),
]
InstrumentName = Annotated[str | None, typer.Option(metavar="NAME", help="The instrument: `kilter instrument list`.")]
ToolForce = Annotated[str | None, typer.Option(metavar="FX,FY,FZ", help="Force on the tool point, in its frame, N.")]
ToolMoment = Annotated[str | None, typer.Option(metavar="MX,MY,MZ", help="Moment on the tool, in its frame, N m.")]


group = typer.Typer(
    help="List, name, retire and purge campaigns; without a command, list those of a robot.",
    rich_markup_mode=None,
    no_args_is_help=True,
    cls=keeping.ListsByDefault,
)


ColumnMap = Annotated[
    Path | None, typer.Option("--map", help="Column map of a lab's own file (TOML).", exists=True, dir_okay=False)
]
MeasuredAt = Annotated[
    str | None,
    typer.Option(metavar="WHEN", help="When the last row was measured: 2026-11-02, or 2026-11-02T14:30."),
]
CampaignName = Annotated[
    str | None,
    typer.Option(help="Name of the campaign; default is the file's, with a number added when that is taken."),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter upload ur10 measurements_grid.csv --device ipa-lasertracker")(upload)
    keeping.register(group, "campaign")
    app.add_typer(group, name="campaigns")


def upload(
    robot: Robot,
    file: File,
    device: Device = None,
    preset: PresetName = None,
    euler: Euler = None,
    joints: Joints = None,
    topic: Topic = None,
    joint_order: JointOrder = None,
    role: Annotated[Role, typer.Option(help="What the measurements are for.")] = "train",
    column_map: ColumnMap = None,
    campaign: IntoCampaign = None,
    name: CampaignName = None,
    payload_kg: Annotated[float | None, typer.Option(help="Mass at the tool point during the campaign, kg.")] = None,
    payload_com_mm: PayloadCentre = None,
    temperature_c: Annotated[float | None, typer.Option(help="Temperature during the campaign, deg C.")] = None,
    tool_force_n: ToolForce = None,
    tool_moment_nm: ToolMoment = None,
    notes: Annotated[str, typer.Option(help="Notes kept with the campaign.")] = "",
    measured_at: MeasuredAt = None,
    instrument: InstrumentName = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Store nothing: show ranges in mm and deg, poses, repeats, loads, what would be refused (then exit 1).",
        ),
    ] = False,
    unchecked: Unchecked = False,
    as_json: Json = False,
) -> None:
    """Upload measurements: contract columns as they are, a device's files converted, a lab's own through a map.

    Makes a campaign, or adds to --campaign. The same file again changes nothing.
    """
    conditions = conditions_of(payload_kg, payload_com_mm, temperature_c, tool_force_n, tool_moment_nm)
    at = moment_of(measured_at)
    if campaign and (name or notes or conditions or at or instrument):
        raise UsageError("--campaign adds to a campaign that has its name, notes and conditions already.")
    prepared = _prepared(robot, file, device, column_map, _Points(preset, euler, joints, topic, joint_order))
    prepared = _understood(file, _looked_at(file, prepared, unchecked), as_json)
    if dry_run:
        found = what_it_holds(robot, prepared, conditions)
        emit(_report(prepared, {"rows": prepared.rows, "sha256": prepared.sha256} | found), as_json, show_dry_run)
        if found["refused"]:
            raise typer.Exit(1)
        return
    wanted = {
        "name": name or file.name,
        "device": device or preset or "",
        "role": role,
        "conditions": conditions,
        "notes": notes,
        "numbered": name is None,
    }
    wanted |= {"measured_at": at, "instrument": instrument}
    done = _stored(robot, campaign, wanted, file, prepared, as_json)
    for text in _odd(done):
        note(f"  Warning: {text}", as_json)
    emit(_report(prepared, done), as_json, _show_upload)


def _stored(
    robot: str, campaign: str | None, wanted: dict[str, Any], file: Path, prepared: Prepared, as_json: bool
) -> dict[str, Any]:
    """Send the rows to the campaign that is named or has them already, else to a new one."""
    with Kilter() as kilter:
        target = _target(kilter, robot, campaign, wanted, prepared.sha256, as_json)
        if target is None:
            return _send_anew(kilter, robot, wanted, file, prepared, as_json)
        with on_interrupt(partial(_added, kilter, target, prepared.sha256)):
            return _send(kilter, target, file, prepared, as_json)


def sent_file(
    robot: str,
    file: Path,
    device: str | None,
    column_map: Path | None,
    role: Role,
    conditions: dict[str, Any],
    name: str,
    measured_at: str | None,
    as_json: bool,
) -> dict[str, Any]:
    """Send a file as a campaign of its own, or find the campaign that has it, and return what was stored."""
    prepared = _prepared(robot, file, device, column_map, _Points(None, None, None))
    prepared = _understood(file, _looked_at(file, prepared, unchecked=False), as_json)
    wanted = {
        "name": name or file.name, "device": device or "", "role": role, "conditions": conditions, "notes": "",
        "numbered": not name, "measured_at": moment_of(measured_at),
    }  # fmt: skip
    return _stored(robot, None, wanted, file, prepared, as_json)


def conditions_of(
    payload_kg: float | None,
    payload_com_mm: str | None,
    temperature_c: float | None,
    force: str | None = None,
    moment: str | None = None,
) -> dict[str, Any]:
    """Return what holds for the whole campaign."""
    told = {
        "payload_kg": payload_kg,
        "payload_com_mm": arguments.three("--payload-com-mm", payload_com_mm),
        "temperature_c": temperature_c,
        "tool_force_n": arguments.three("--tool-force-n", force),
        "tool_moment_nm": arguments.three("--tool-moment-nm", moment),
    }
    return {key: value for key, value in told.items() if value is not None}


@dataclass(frozen=True)
class _Points:
    """What was said of a text export of points."""

    preset: str | None
    euler: str | None
    joints: Path | None
    topic: str | None = None
    joint_order: str | None = None


def _prepared(robot: str, file: Path, device: str | None, column_map: Path | None, points: _Points) -> Prepared:
    """Read the file: points by a preset (``--preset``, or a device of that name), else as ``prepare`` does."""
    preset = points.preset or (
        device if device in PRESETS and file.suffix.lower() not in (".json", ".parquet") else None
    )
    if preset is None or column_map is not None:
        if replace(points, joints=None) != _Points(None, None, None):
            raise UsageError(
                "--preset, --euler, --topic and --joint-order belong to a text export of points, without --map."
            )
        if points.joints is not None and column_map is None:
            raise UsageError(
                "--joints goes with --preset (a text export of points) or with --map (a column map with a table [join])."
            )
        return prepare(file, device, column_map, points.joints)
    if preset not in PRESETS:
        raise UsageError(f"--preset {preset}: is not one of {', '.join(PRESETS)}.")
    check_numpy()
    from kilter_files.formats.joints.joint_log import read_joint_log
    from kilter_files.formats.reader import LogHints
    from kilter_files.formats.registry import recognised
    from kilter_files.rig.points import prepare_points

    if points == _Points(None, None, None) and recognised(file, "contract-columns"):
        return prepare(file)
    log = None
    if points.joints is not None:
        order = arguments.split_names([points.joint_order or ""])
        likely = joints_of(robot) if recognised(points.joints, "bag") and not order else ()
        log = read_joint_log(points.joints, hints=LogHints(points.topic, order, likely))
    return prepare_points(file, preset, points.euler, log)


def _looked_at(file: Path, prepared: Prepared, unchecked: bool) -> Prepared:
    """Look for knocked markers, where there are markers, and numpy to do so."""
    header = prepared.content.split(b"\n", 1)[0]
    if prepared.content_type == CSV_TYPE and not A_MARKER.search(header):
        return prepared  # numpy would be loaded for nothing
    try:
        from kilter_files.match.uploaded_markers import refuse_knocked_rows
    except ImportError:
        return prepared
    found = refuse_knocked_rows(file, prepared, unchecked)
    return replace(prepared, warnings=(*prepared.warnings, *found)) if found else prepared


@group.command("list", epilog="Example: kilter campaigns list ur10")
def list_(robot: Robot, retired: Retired = False, as_json: Json = False) -> None:
    """List the campaigns of a robot."""
    with Kilter() as kilter:
        document = {"campaigns": kilter.campaigns.list(robot, retired=retired)}
    emit(document, as_json, _show_campaigns)


def _target(
    kilter: Kilter, robot: str, campaign: str | None, wanted: dict[str, Any], sha256: str, as_json: bool
) -> str | None:
    """Return the campaign to add to: the one that is named, or the one that has these bytes already."""
    if campaign:
        return resolved(kilter, "campaign", campaign, robot, as_json, "--campaign")
    return _known(kilter, robot, wanted, sha256)


def _known(kilter: Kilter, robot: str, wanted: dict[str, Any], sha256: str) -> str | None:
    """Return the campaign that has these bytes already."""
    for known in kilter.campaigns.list(robot):
        if same(known, wanted) and any(done["sha256"] == sha256 for done in known["uploads"]):
            return str(known["id"])
    return None


def _send_anew(
    kilter: Kilter, robot: str, wanted: dict[str, Any], file: Path, prepared: Prepared, as_json: bool
) -> dict[str, Any]:
    """Send to a new campaign, which is seen only when the rows are in it; a refused file leaves nothing."""
    target = str(kilter.campaigns.add(robot, **wanted, staged=True)["id"])
    with on_interrupt(partial(_taken_back, kilter, target)):
        try:
            done = _send(kilter, target, file, prepared, as_json)
        except ApiError:
            kilter.campaigns.discard(target)
            raise
        kilter.campaigns.commit(target, [str(done["sha256"])])
    return done


def _taken_back(kilter: Kilter, campaign: str) -> str:
    """Drop a campaign that was broken off, and say what is left of it."""
    try:
        kilter.campaigns.discard(campaign)
    except ConflictError:  # its last request had reached the server
        return f"campaign {campaign} is stored completely."
    except KilterError as error:
        return (
            f"campaign {campaign} is begun but not visible, and could not be withdrawn ({error.detail}). "
            "The same command sends the file again."
        )
    return "nothing is stored. The same command sends the file again."


def _added(kilter: Kilter, campaign: str, sha256: str) -> str:
    """Say whether rows that were being added are there."""
    try:
        there = any(upload["sha256"] == sha256 for upload in kilter.campaigns.get(campaign)["uploads"])
    except KilterError:
        return (
            f"the rows are in campaign {campaign} or not at all. The same command again changes nothing that is there."
        )
    if there:
        return f"the rows are stored in campaign {campaign}."
    return f"nothing is added to campaign {campaign}. The same command sends the file again."


def _send(kilter: Kilter, campaign: str, file: Path, prepared: Prepared, as_json: bool) -> dict[str, Any]:
    try:
        with upload_bar(file.name, as_json) as sent:
            return kilter.campaigns.upload(campaign, prepared, sent)
    except ObservationError as error:
        raise _with_place(error, file, prepared) from error


def _with_place(error: ObservationError, file: Path, prepared: Prepared) -> ObservationError:
    """Add where the refused row stands in the person's own file, or how such a file comes in."""
    row = error.context.get("row")
    if prepared.lines and isinstance(row, int) and 0 < row <= len(prepared.lines):
        error.context |= {"file": str(file), "line": prepared.lines[row - 1]}
        rows = [k for k in error.context.get("rows") or () if isinstance(k, int) and 0 < k <= len(prepared.lines)]
        lines = [prepared.lines[k - 1] for k in rows or [row]]
        error.context["lines"] = lines
        shown = ", ".join(map(str, lines[:SHOWN])) + (" ..." if len(lines) > SHOWN else "")
        error.detail += f" That is line {shown} of {file}."
    elif not prepared.lines and row is None and error.code == "observations_invalid":
        error.detail += f" {REMEDY_FOR_COLUMNS}"
    return error


def _understood(file: Path, prepared: Prepared, as_json: bool) -> Prepared:
    """Say what is understood of the file."""
    note(f"{file}: {'' if prepared.rows is None else f'{prepared.rows} rows'}".rstrip(": "), as_json)
    for text in prepared.notes:
        note(f"  {text}", as_json)
    for text in prepared.warnings:
        note(f"  Warning: {text}.", as_json)
    return prepared


def _report(prepared: Prepared, done: dict[str, Any]) -> dict[str, Any]:
    understood = {"columns": list(prepared.columns), "notes": list(prepared.notes), "warnings": list(prepared.warnings)}
    return understood | done | {"warnings": understood["warnings"] + _odd(done)}


def _odd(done: dict[str, Any]) -> list[str]:
    """What the server found odd in rows that it stored."""
    return [str(one["message"]) for one in done.get("warnings", ())]


def _show_upload(done: dict[str, Any]) -> None:
    known = "" if done.get("new", True) else ", there already"
    say(f"campaign {done['campaign_id']}: {done['rows']} rows{known} (sha256 {done['sha256'][:12]})")


def _show_campaigns(document: dict[str, Any]) -> None:
    rows = [
        (
            c["id"],
            c["name"] + (" (retired)" if c.get("retired_at") else ""),
            c["device"],
            c["role"],
            str(c["rows"]),
            str(c["created_at"])[:16].replace("T", " "),
        )
        for c in document["campaigns"]
    ]
    show_rows(("campaign", "name", "device", "role", "rows", "made"), rows)
