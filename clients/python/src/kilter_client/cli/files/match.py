"""``kilter measure match``: a recording joined with its joint log, shown, written, or sent in parts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.files.inspect import (
    AllowCut,
    Calibration,
    JointOrder,
    NormMode,
    Rate,
    Topic,
    Unit,
    Zero,
    check_numpy,
    fetch_joint_names,
)
from kilter_client.cli.files.sending import calibration_conditions
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, note, print_line, upload_bar
from kilter_client.cli.terminal.references import on_interrupt
from kilter_client.errors import UsageError
from kilter_client.files import files_match, files_tables
from kilter_files import read_joints
from kilter_files.formats import LogHints, has_format, open_recording
from kilter_files.tables import Prepared, Table

if TYPE_CHECKING:
    from kilter_files.match import Arm, Body, Checks
    from kilter_files.tables import JointLog, Recording

Model = Annotated[str | None, typer.Option(help="Robot whose model checks the pairing; default is --robot's.")]
Piecewise = Annotated[bool, typer.Option("--piecewise", help="Match the parts between jumps of the clocks.")]
Unchecked = Annotated[bool, typer.Option("--unchecked", help="Only warn of wrong pairs and knocks.")]


def build_checks(
    robot: str | None, piecewise: bool, unchecked: bool, since: float | None, until: float | None
) -> Checks:
    """Return the checks, with the model of a robot of the server.

    Raises:
        UsageError: times the wrong way round, or ``--piecewise`` without a robot.

    """
    if since is not None and until is not None and not since < until:
        raise UsageError(f"--since {since:g} --until {until:g}: the first must be earlier than the second.")
    if piecewise and robot is None:
        raise UsageError("--piecewise needs the robot's model: name it with --robot or --model.")
    start, end = -float("inf") if since is None else since, float("inf") if until is None else until
    return files_match.Checks(None if robot is None else fetch_arm_model(robot), piecewise, unchecked, start, end)


def fetch_arm_model(robot: str) -> Arm:
    """Return the model of a robot of the server."""
    with Kilter() as kilter:
        return files_match.arm_from_check(kilter.robots.check(kilter.robots.get(robot)["document"]))


def drop_markers_if_any(recording: Recording, without: Sequence[str] | None) -> Recording:
    """Return a recording without some markers."""
    return files_tables.drop_markers(recording, without) if without else recording


def in_time(recording: Recording, checks: Checks) -> Recording:
    """Return the part of a recording that counts."""
    return files_tables.cut_to_interval(recording, checks.since_s, checks.until_s)


By = Literal["order", "time", "frames"]
How = Annotated[By, typer.Option(help="One row per dwell, in order or by time; or a row of every frame, by time.")]
Role = Literal["train", "validation", "confirmation"]
Existing = {"exists": True, "dir_okay": False, "show_default": False}
Tcp = Annotated[
    str | None,
    typer.Option(
        metavar="mean|X,Y,Z|FILE",
        help="Send poses of one rigid body instead of markers: of the markers' mean, of a point in the body's frame (mm), "
        "or of the point that FILE has digitised as its last marker.",
    ),
]
Joints = Annotated[
    Path,
    typer.Argument(
        help="The joint log: CSV, Parquet, a ROS 2 bag, or a program's targets.",
        metavar="JOINTS",
        show_default=False,
        exists=True,
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure match optotrak.c3d joints.csv --by time --robot my-arm")(match)


def match(
    recording: Annotated[Path, typer.Argument(help="The recording of markers.", metavar="RECORDING", **Existing)],
    joints: Joints,
    by: How = "order",
    joints_map: Annotated[Path | None, typer.Option(help="Column map of the joint log.", **Existing)] = None,
    tcp: Tcp = None,
    tool: Annotated[str | None, typer.Option(help="Tool of a recording of several, where --tcp asks for one.")] = None,
    topic: Topic = None,
    joint_order: JointOrder = None,
    calibration: Calibration = None,
    norm_mode: NormMode = None,
    zero: Zero = "new",
    rate: Rate = None,
    allow_cut: AllowCut = False,
    unit: Unit = None,
    rest_speed: Annotated[float | None, typer.Option(help="Slower than this is rest, mm/s.")] = None,
    shortest: Annotated[float, typer.Option(help="Shortest dwell, s.")] = 0.3,
    settle: Annotated[float, typer.Option(help="Left out at the beginning of a dwell, s.")] = 0.1,
    out: Annotated[Path | None, typer.Option(help="Write the rows to this .csv (--by order, time).")] = None,
    robot: Annotated[str | None, typer.Option(help="Send the rows to this robot; without it nothing is sent.")] = None,
    model: Model = None,
    piecewise: Piecewise = False,
    since: Annotated[float | None, typer.Option(help="Only from this time of the recording, s.")] = None,
    until: Annotated[float | None, typer.Option(help="Only to this time of the recording, s.")] = None,
    without: Annotated[list[str] | None, typer.Option(metavar="MARKER", help="Leave this marker out (repeat).")] = None,
    unchecked: Unchecked = False,
    name: Annotated[str | None, typer.Option(help="Name of the campaign; default is the recording's.")] = None,
    device: Annotated[str, typer.Option(help="Measuring device.")] = "optotrak",
    role: Annotated[Role, typer.Option(help="What the measurements are for.")] = "train",
    as_json: Json = False,
) -> None:
    """Join a recording with a joint log and report how well; with --robot, send it. Sent again, it goes on."""
    check_numpy()
    if by == "frames" and out is not None:
        raise UsageError("--out writes dwells; every frame is sent with --robot, in parts.")
    found = drop_markers_if_any(open_recording(recording, rate, allow_cut, unit), without)
    order, servos = arguments.split_names([joint_order or ""]), (calibration, norm_mode, zero)
    log = _log(joints, joints_map, topic, order, servos, robot or model, as_json)
    checks = build_checks(model or robot, piecewise, unchecked, since, until)
    if tcp is not None and (tool is not None or found.kind.startswith("tool-")):
        found = files_match.tool_as_markers(found, tool)
    if by != "order":
        found = in_time(found, checks)
    body = None if tcp is None else _body(in_time(found, checks), tcp)
    if body is not None:
        note(f"  poses of a rigid body: {body.source}, tool point {body.tcp.round(3).tolist()} mm", as_json)
    own = {"name": name or recording.name, "device": device, "role": role, "numbered": name is None}
    wanted = own | calibration_conditions(log)
    if by == "frames":
        document = _frames(found, log, body, checks, robot, wanted, as_json)
    else:
        options = files_match.RestOptions(rest_speed, shortest, settle)
        document = _dwells(found, log, body, by, (options, checks), out, robot, wanted, as_json)
    emit(document, as_json, _show)


def _log(
    joints: Path,
    joints_map: Path | None,
    topic: str | None,
    order: list[str],
    servos: tuple[Path | None, str | None, str],
    robot: str | None,
    as_json: bool,
) -> JointLog:
    """Read the joint log, and say what was understood of it; ``servos`` are a data set's calibration, norm mode and zero."""
    likely = fetch_joint_names(robot) if has_format(joints, "bag") else ()
    log = read_joints(joints, joints_map, LogHints(topic, order, likely, *servos))
    for text in log.notes:
        note(f"  {text}", as_json)
    return log


def _body(recording: Recording, tcp: str) -> Body:
    """Find the rigid body of the markers, with the tool point that is given or digitised in another recording."""
    return files_match.find_body(
        recording, open_recording(Path(tcp)) if files_match.names_a_file(recording, tcp) else tcp
    )


def _dwells(
    found: Recording,
    log: JointLog,
    body: Body | None,
    by: str,
    options: Any,
    out: Path | None,
    robot: str | None,
    wanted: dict[str, Any],
    as_json: bool,
) -> dict[str, Any]:
    matched = files_match.match_dwells(found, log, by, options[0], body, options[1])
    _print_match_report(matched.report, as_json)
    rows = matched.report["dwells"]
    table: Table = Table({n: v.tolist() for n, v in matched.columns.items()}, list(range(1, rows + 1)))
    prepared = Prepared.from_table(table)
    document = dict(matched.report) | {"rows": rows, "columns": list(matched.columns), "sha256": prepared.sha256}
    if out is not None:
        out.write_bytes(prepared.content)
        document["out"] = str(out)
    return document | (_send(lambda: [prepared], rows, robot, wanted, as_json) if robot else {})


def _frames(
    found: Recording,
    log: JointLog,
    body: Body | None,
    checks: Checks,
    robot: str | None,
    wanted: dict[str, Any],
    as_json: bool,
) -> dict[str, Any]:
    from kilter_client.cli.files.parts import cut_parquet_parts

    pieces, warnings = files_match.match_frames(found, log, checks)
    report = {
        "clock": files_match.clock_report(pieces, found.duration_s),
        "warnings": [*found.warnings, *log.warnings, *warnings],
    }
    _print_match_report(report, as_json)
    if not robot:
        return report | {"frames": found.frames}
    return report | _send(
        lambda: cut_parquet_parts(files_match.frame_rows(found, log, pieces, body)),
        found.frames,
        robot,
        wanted,
        as_json,
    )


def _send(pieces: Any, rows: int, robot: str, wanted: dict[str, Any], as_json: bool) -> dict[str, Any]:
    from kilter_client.cli.files.parts import send_whole

    done = {"rows": 0}
    with Kilter() as kilter, upload_bar(wanted["name"], as_json) as bar:

        def progress(count: int, there: bool) -> None:
            done["rows"] += count
            bar(done["rows"], max(rows, done["rows"]))

        with on_interrupt(lambda: f"{done['rows']} rows are kept for it. The same command continues where it stopped."):
            sent = send_whole(kilter, robot, dict(wanted), pieces, progress)
    return {"campaign_id": sent.campaign_id, "rows": sent.rows, "rows_there_already": sent.there}


def _print_match_report(report: dict[str, Any], as_json: bool) -> None:
    clock = report.get("clock")
    if "dwells" in report:
        scatter = ", ".join(f"{v:.4f}" for v in report["scatter_mm"])
        note(
            f"{report['dwells']} dwells at {report['poses']} poses; scatter of a frame {scatter} mm (x, y, z)", as_json
        )
    if clock is not None:
        note(
            f"joint log = recording {clock['offset_s']:+.6f} s (± {clock['offset_sigma_s'] * 1e6:.0f} µs), drift "
            f"{clock['drift_ppm']:+.2f} ppm (± {clock['drift_sigma_ppm']:.2f})",
            as_json,
        )
    for text in report["warnings"]:
        note(f"  Warning: {text}.", as_json)


def _show(document: dict[str, Any]) -> None:
    if "campaign_id" in document:
        there = document["rows_there_already"]
        print_line(
            f"campaign {document['campaign_id']}: {document['rows']} rows"
            + (f", {there} there already" if there else "")
        )
    elif "out" in document:
        print_line(f"{document['out']}: {document['rows']} rows")
    else:
        print_line("Nothing was sent: name the robot with --robot.")
