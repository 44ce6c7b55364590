"""``kilter upload``: a file is read and mapped, its rows are checked, and they are sent.

What `kilter upload` takes a file for where nobody said it; where two readings are possible, a person decides.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.files.inspect import JointOrder, Topic, fetch_joint_names
from kilter_client.cli.files.match import match
from kilter_client.cli.files.sending import rig_conditions, send, stated_servos
from kilter_client.cli.reports.answer import fit_messages, suggest_after_upload
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import ColumnMap, File, Json, PayloadCentre, Robot
from kilter_client.cli.terminal.output import emit, note, number, print_line, print_lines, screen_columns, show_rows
from kilter_client.cli.terminal.references import in_words, parameters_by_request_name, resolve_reference
from kilter_client.errors import FileError, KilterError, UsageError
from kilter_client.files import files_match
from kilter_client.verbs import campaigns
from kilter_client.verbs.campaigns import checked_here, checked_rows
from kilter_client.verbs.inputs import parse_time
from kilter_files import Prepared, draft, has_contract_header, prepare, read_joints
from kilter_files.formats import (
    DEVICE,
    MAP,
    PRESET,
    PRESETS,
    Head,
    Hints,
    LogHints,
    RecordingReader,
    find_reader,
    has_format,
)
from kilter_files.match import checked_markers

if TYPE_CHECKING:
    from kilter_files.look import Draft


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


MOST_UNUSED = 4  # columns that are named
UNITS = {"rad": "radians", "deg": "degrees"}
ORDERS = {"XYZ": "about the moving axes", "xyz": "about the fixed axes"}


def is_recording(file: Path) -> bool:
    """Tell whether a file holds frames of markers, which `kilter measure match` joins with a joint log."""
    return isinstance(find_reader(Head(file)), RecordingReader)


def guess_pairing(file: Path, joints: Path, hints: LogHints, as_json: bool) -> Literal["order", "time"]:
    """Return how a joint log is paired with a recording, and say it: by time where it shows the arm moving, else in order."""
    log = read_joints(joints, None, hints)
    moving = log.t_s is not None and len(files_match.pose_row_indices(log)) < len(log)
    by: Literal["order", "time"] = "time" if moving else "order"
    note(f"{file}: taken as a recording of markers, joined with {joints} by {by} (`kilter measure match`)", as_json)
    return by


def read_unstated(
    robot: str, file: Path, joints: Path | None, euler: str | None, joint_unit: str | None, hints: LogHints
) -> tuple[Prepared, str]:
    """Return the rows of a file of which nobody said what it is, and what device it is taken for; empty: none.

    The first note says what was taken. A file that has columns of the contract is sent as it is.

    Raises:
        FileError: the file, or what it was taken for, is not what it should be.
        UsageError: two readings are possible; the message names both and the option that decides.

    """
    if (hints.topic or hints.order) and joints is None:
        return prepare(file, euler=euler, hints=hints), ""
    reader, names = find_reader(Head(file)), list[str]()
    if isinstance(reader, RecordingReader):
        raise FileError(f"{file}: is a recording of markers, without joints. Name the joint log too: --joints FILE.")
    if reader.use in (MAP, PRESET) and joints is None:
        names = _joint_names_if_known(robot)  # columns that carry them are those joints
        reader = find_reader(Head(file, Hints(robot=names)))
    if reader.use == DEVICE and joints is None:
        read = prepare(file, reader.name)
        taken = (f"taken as {reader.title} (--device {reader.name})",) if read.rows is not None else ()
        return replace(read, notes=(*taken, *read.notes)), reader.name
    if reader.use == PRESET and joints is not None:
        return _read_points(file, joints, euler, hints), "generic"
    if reader.use == MAP and joints is None:
        found = draft(file, names)
        if not found.has_contract_joints and (euler is None or found.open == ["orientation"]):
            return _read_drafted(file, found, _decide(robot, file, found, euler, joint_unit)), ""
    return prepare(file, joined=joints, euler=euler, hints=hints), ""


def _read_points(file: Path, joints: Path, euler: str | None, hints: LogHints) -> Prepared:
    try:
        read = prepare(file, joined=joints, preset="generic", euler=euler, hints=hints)
    except FileError as why:
        try:
            return prepare(file, joined=joints, euler=euler, hints=hints)
        except UsageError as usage:
            raise UsageError(f"{why.detail} {usage.detail}") from why
    return replace(read, notes=("taken as points of a tracker or CMM (--preset generic)", *read.notes))


def _read_drafted(file: Path, found: Draft, text: str) -> Prepared:
    """Read a file through the text of a map, and say in a line what was taken."""
    with tempfile.TemporaryDirectory() as folder:
        column_map = Path(folder) / "columns.toml"
        column_map.write_text(text, encoding="utf-8")
        read = prepare(file, None, column_map)
    left = found.unused[:MOST_UNUSED]
    more = f" and {len(found.unused) - len(left)} more" if len(found.unused) > len(left) else ""
    unused = f"; not used: {', '.join(left)}{more}" if left else ""
    return replace(read, notes=(f"taken as {found.readings}{unused} (--map says otherwise)",))


def _decide(robot: str, file: Path, found: Draft, euler: str | None, joint_unit: str | None) -> str:
    """Return the text of the map where one reading is possible or was said."""
    remedy = f"`kilter measure inspect {quote(str(file))} --robot {robot} --draft columns.toml` writes a map for --map."
    text, still_open = found.text, list(found.open)
    if still_open == ["orientation"] and 'euler = "?"' in text:
        order = _choose(file, "its angles are", ORDERS, euler, "--euler", remedy)
        text, still_open = text.replace('euler = "?"', f'euler = "{order}"'), []
    if still_open:
        raise UsageError(f"{file}: could not find out {', '.join(still_open)}. {remedy}")
    if found.rivals:
        raise UsageError(
            f"{file}: two readings are possible: {found.readings.partition(';')[0]}, or {' and '.join(found.rivals)}. {remedy}"
        )
    if found.least_reach_mm is not None and (joint_unit or not _is_out_of_reach(robot, found.least_reach_mm)):
        unit = _choose(file, "its joints are in", UNITS, joint_unit, "--joint-unit", remedy)
        text = text.replace('unit = "rad"', f'unit = "{unit}"')
    return text


def _choose(file: Path, what: str, readings: Mapping[str, str], said: str | None, option: str, remedy: str) -> str:
    """Return which of two readings holds: the one that was said, or that a person at the terminal chooses."""
    options = " or ".join(f"{words} ({option} {word})" for word, words in readings.items())
    if said is None and sys.stdin.isatty():
        said = typer.prompt(f"{file}: {what} {options}. Which", err=True)
    if said is not None and said in readings:
        return said
    raise UsageError(f"{file}: two readings are possible: {what} {options}. Say which; or {remedy}")


def _is_out_of_reach(robot: str, least_mm: float) -> bool:
    """Tell whether no arm of this size moves as was measured; not where the robot is not known."""
    try:
        with Kilter() as kilter:
            return bool(kilter.robots.check(kilter.robots.get(robot)["document"])["reach_mm"] < least_mm)
    except KilterError:
        return False


def _joint_names_if_known(robot: str) -> list[str]:
    try:
        return fetch_joint_names(robot)
    except KilterError:  # a dry run needs no server
        return []
