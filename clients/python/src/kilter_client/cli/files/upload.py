"""``kilter upload``: a file is read and mapped, its rows are checked, and they are sent."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.files.calibrated_rows import stated_servos
from kilter_client.cli.files.inspect import JointOrder, Topic, fetch_joint_names
from kilter_client.cli.files.match import match
from kilter_client.cli.files.readings import guess_pairing, is_recording, read_unstated
from kilter_client.cli.files.sending import rig_conditions, send
from kilter_client.cli.reports.answer import fit_messages
from kilter_client.cli.reports.next_step import suggest_after_upload
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import ColumnMap, File, Json, PayloadCentre, Robot
from kilter_client.cli.terminal.output import emit, note, number, print_line, print_lines, screen_columns, show_rows
from kilter_client.cli.terminal.references import resolve_reference
from kilter_client.cli.terminal.wording import in_words, parameters_by_request_name
from kilter_client.errors import KilterError, UsageError
from kilter_client.verbs import campaigns
from kilter_client.verbs.dry_run import checked_here, checked_rows
from kilter_client.verbs.inputs import parse_time
from kilter_files import Prepared, has_contract_header, prepare
from kilter_files.formats import PRESETS, LogHints, has_format
from kilter_files.match import checked_markers

Document = dict[str, Any]

MOST_COLUMNS, LINES_FOUND, MOST_JOINTS = 13, 7, 4  # shown of a dry run
LOAD_UNITS = {"kg": "kg", "mm": "mm", "m": "m", "n": "N", "nm": "N m"}


def what_it_holds(
    robot: str, prepared: Prepared, wanted: Mapping[str, Any], campaign: str | None = None, as_json: bool = False
) -> Document:
    """Return ranges, poses, repeats, loads, directions, and what rules left out or would refuse.

    ``wanted`` is the campaign that an upload would make, or ``campaign`` the one that it would add to.
    """
    known = {"rows": prepared.rows, "sha256": prepared.sha256}
    try:
        kilter = Kilter()
    except KilterError as error:  # a dry run needs no server
        return known | checked_here(prepared, wanted["conditions"], error)
    with kilter:
        into = resolve_reference(kilter, "campaign", campaign, robot, as_json, "--campaign") if campaign else None
        return known | kilter.run(checked_rows(robot, prepared, wanted, into, _rephrase_for_upload))


def _rephrase_for_upload(detail: str) -> str:
    return in_words(detail, parameters_by_request_name(["upload"]))


def show_dry_run(document: Document) -> None:
    """Print what would be refused, then what a file holds, for people."""
    found = [f"would be refused: {text}" for text in document["refused"] or ("nothing found",)]
    found += [f"looks odd: {text}" for text in document["odd"]]
    found += [f"left out: {text}" for text in document["left_out"]]
    found += [f"not checked: {document['not_checked']}"] if document["not_checked"] else []
    lines = fit_messages(found, screen_columns(), LINES_FOUND, "(--json)")
    for line in lines:
        print_line(line)
    rows = [
        (c["name"], c["unit"], *("" if c[k] is None else f"{c[k]:.6g}" for k in ("low", "high")), str(c["empty"] or ""))
        for c in document.get("ranges", ())
    ]
    if rows:
        shown = MOST_COLUMNS - len(lines)
        show_rows(("column", "unit", "lowest", "highest", "empty"), rows[:shown])
        more = f"; {len(rows) - shown} more columns (--json)" if len(rows) > shown else ""
        print_line(f"rows: {document['rows']}{more}")
        print_line(f"poses: {_poses(document['poses'])}")
        print_line(f"loads: {_loads(document['loads'])}")
        print_line(f"directions: {_directions(document['directions'])}")
    print_line("Nothing was stored.")


def _poses(poses: Document | None) -> str:
    if poses is None:
        return "not known"
    visits, rows = (_span(poses[key]) for key in ("visits_per_pose", "rows_per_pose"))
    repeats = "none is repeated" if not poses["repeated"] else f"{poses['repeated']} of them repeated"
    counted = f"{visits} visit{'' if visits == '1' else 's'} per pose ({rows} row{'' if rows == '1' else 's'})"
    return f"{poses['count']} by {poses['by']}, {counted}, {repeats}"


def _span(pair: list[int]) -> str:
    return str(pair[0]) if pair[0] == pair[1] else f"{pair[0]} to {pair[1]}"


def _loads(loads: Document) -> str:
    said = []
    for name, values in loads.items():
        unit = LOAD_UNITS.get(name.rpartition("_")[2], "")
        if name.endswith("_distinct"):
            continue
        listed = values if isinstance(values, list) else [values]
        many = loads.get(f"{name}_distinct")
        text = (
            f"{number(listed[0])} to {number(listed[-1])}, {many} different" if many else ", ".join(map(number, listed))
        )
        of_all = name.removeprefix("campaign_")
        said.append(f"{of_all.rpartition('_')[0]} {text} {unit}" + (" (whole campaign)" if of_all != name else ""))
    return "; ".join(said) or "not given (payload_kg, or --payload-kg)"


def _directions(directions: Document) -> str:
    parts = [f"{name} {count['-1']} down, {count['0']} unknown, {count['1']} up" for name, count in directions.items()]
    left = len(parts) - MOST_JOINTS
    return "; ".join([*parts[:MOST_JOINTS], *([f"{left} more (--json)"] if left > 0 else [])]) or "not given (dir1 ...)"


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
    str | None, typer.Option(help="Measuring device; `kilter measure formats` lists those whose files are converted.")
]
IntoCampaign = Annotated[
    str | None,
    typer.Option("--campaign", metavar="ID", help="Add to this campaign (id, name or `latest`) instead of making one."),
]
InstrumentName = Annotated[
    str | None, typer.Option(metavar="NAME", help="The instrument: `kilter measure instrument list`.")
]
Unchecked = Annotated[bool, typer.Option("--unchecked", help="Store rows that look mixed up, with a warning.")]
ToolForce = Annotated[str | None, typer.Option(metavar="FX,FY,FZ", help="Force on the tool point, in its frame, N.")]
ToolMoment = Annotated[str | None, typer.Option(metavar="MX,MY,MZ", help="Moment on the tool, in its frame, N m.")]
MeasuredAt = Annotated[
    str | None,
    typer.Option(metavar="WHEN", help="When the last row was measured: 2026-11-02, or 2026-11-02T14:30."),
]
CampaignName = Annotated[
    str | None,
    typer.Option(help="Name of the campaign; default is the file's, with a number added when that is taken."),
]


CamerasFile = Annotated[
    Path | None,
    typer.Option(
        "--cameras",
        metavar="FILE",
        help="Cameras and boards of views: the JSON that `kilter measure see` writes.",
        exists=True,
        dir_okay=False,
    ),
]


ServoCalibration = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="JSON",
        help="LeRobot's calibration of the servos that read the joints.",
        exists=True,
        dir_okay=False,
    ),
]

JointUnit = Annotated[
    Literal["rad", "deg"] | None,
    typer.Option("--joint-unit", help="Unit of joints of a file that states none, where its numbers do not decide."),
]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Store nothing: show ranges in mm and deg, poses, repeats, loads, what would be refused (then exit 1).",
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter upload ur10 measurements_grid.csv --device ipa-lasertracker")(upload)


def upload(
    robot: Robot,
    file: File,
    device: Device = None,
    preset: PresetName = None,
    euler: Euler = None,
    joints: Joints = None,
    joint_unit: JointUnit = None,
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
    cameras: CamerasFile = None,
    calibration: ServoCalibration = None,
    notes: Annotated[str, typer.Option(help="Notes kept with the campaign.")] = "",
    measured_at: MeasuredAt = None,
    instrument: InstrumentName = None,
    dry_run: DryRun = False,
    unchecked: Unchecked = False,
    as_json: Json = False,
) -> None:
    """Upload measurements: how a file is read is found out, and said; --device, --preset or --map say it instead.

    A recording of markers is joined with --joints. Makes a campaign, or adds to --campaign; the same file changes nothing.
    """
    stated = (payload_kg, payload_com_mm, temperature_c, tool_force_n, tool_moment_nm)
    conditions, at = build_conditions(*stated, cameras, unchecked and not campaign), parse_time(measured_at)
    if campaign and (name or notes or conditions or at or instrument or calibration):
        raise UsageError("--campaign adds to a campaign that has its name, notes and conditions already.")
    order = arguments.split_names([joint_order]) if joint_order else []
    if joints is not None and not (device or preset or column_map) and is_recording(file):
        if conditions or campaign or notes or at or instrument or calibration:
            raise UsageError(
                f"{file}: is a recording. Join it by `kilter measure match --out r.csv`, then upload r.csv."
            )
        to = {"model": robot} if dry_run else {"robot": robot, "name": name}
        by = guess_pairing(file, joints, LogHints(topic, order, fetch_joint_names(robot)), as_json)
        match(
            file,
            joints,
            by,
            topic=topic,
            joint_order=joint_order,
            role=role,
            unchecked=unchecked,
            as_json=as_json,
            **to,
        )
        return
    # The robot's joints, where a bag names its joints and nobody said which is the first.
    asks = joints is not None and column_map is None and not joint_order and has_format(joints, "bag")
    hints = LogHints(topic, order, fetch_joint_names(robot) if asks else [])
    if device or preset or column_map or has_contract_header(file):
        read = prepare(file, device, column_map, joints, preset=preset, euler=euler, hints=hints)
    else:
        read, device = read_unstated(robot, file, joints, euler, joint_unit, hints)
    prepared = checked_markers(file, read, unchecked)
    servos, prepared = stated_servos(robot, calibration, prepared, file, dry_run) if calibration else ({}, prepared)
    _print_file_notes(file, prepared, as_json)
    wanted = {
        "name": name or file.name,
        "device": device or preset or "",
        "role": role,
        "conditions": conditions | servos,
        "notes": notes,
        "numbered": name is None,
        "measured_at": at,
        "instrument": instrument,
    }
    if dry_run:
        done = what_it_holds(robot, prepared, wanted, campaign, as_json)
    else:
        done = send(robot, campaign, wanted, file, prepared, as_json)
    odd = [str(one["message"]) for one in done.get("warnings", ())]  # what the server found in rows that it stored
    for text in odd:
        note(f"  Warning: {text}", as_json)
    report = {"columns": list(prepared.columns), "notes": list(prepared.notes)} | done
    report["warnings"] = [*prepared.warnings, *odd]
    emit(report, as_json, show_dry_run if dry_run else partial(_show_upload, robot))
    if dry_run and done["refused"]:
        raise typer.Exit(1)


def sent_file(
    robot: str,
    file: Path,
    device: str | None,
    column_map: Path | None,
    role: Role,
    conditions: dict[str, Any],
    name: str,
    measured_at: str | None,
    instrument: str | None,
    as_json: bool,
) -> dict[str, Any]:
    """Send a file as a campaign of its own, or find the campaign that has it, and return what was stored."""
    prepared = checked_markers(file, prepare(file, device, column_map), unchecked=False)
    _print_file_notes(file, prepared, as_json)
    wanted = {
        "name": name or file.name,
        "device": device or "",
        "role": role,
        "conditions": conditions,
        "notes": "",
        "numbered": not name,
        "measured_at": parse_time(measured_at),
        "instrument": instrument,
    }
    return send(robot, None, wanted, file, prepared, as_json)


def build_conditions(
    payload_kg: float | None,
    payload_com_mm: str | None,
    temperature_c: float | None,
    force: str | None = None,
    moment: str | None = None,
    cameras: Path | None = None,
    unchecked: bool = False,
) -> dict[str, Any]:
    """Return what holds for the whole campaign."""
    stated = (rig_conditions(cameras) if cameras else {}) | ({"unchecked": True} if unchecked else {})
    return stated | campaigns.build_conditions(
        payload_kg=payload_kg,
        payload_com_mm=arguments.three("--payload-com-mm", payload_com_mm),
        temperature_c=temperature_c,
        tool_force_n=arguments.three("--tool-force-n", force),
        tool_moment_nm=arguments.three("--tool-moment-nm", moment),
    )


def _print_file_notes(file: Path, prepared: Prepared, as_json: bool) -> None:
    """Say what is understood of the file."""
    note(f"{file}: {'' if prepared.rows is None else f'{prepared.rows} rows'}".rstrip(": "), as_json)
    for text in prepared.notes:
        note(f"  {text}", as_json)
    for text in prepared.warnings:
        note(f"  Warning: {text}.", as_json)


def _show_upload(robot: str, done: dict[str, Any]) -> None:
    known = "" if done.get("new", True) else ", there already"
    fine = "" if done["warnings"] else "; nothing looks wrong with them"
    print_line(f"campaign {done['campaign_id']}: {done['rows']} rows{known}{fine}.")
    with Kilter() as kilter:
        print_lines(suggest_after_upload(kilter, robot, done["campaign_id"]))
