"""``kilter correct``: a trajectory in, the corrected one out."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.reports.answer import format_next
from kilter_client.cli.reports.results import show_today
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import ColumnMap, File, Json, PayloadCentre, PayloadOnPath, Robot
from kilter_client.cli.terminal.output import emit, is_note_due, note, print_line, print_lines
from kilter_client.cli.terminal.references import on_interrupt
from kilter_client.errors import UsageError
from kilter_files import prepare
from kilter_files.tables import CSV_TYPE, JSON_TYPE

if TYPE_CHECKING:
    from kilter_client.results.corrected import Corrected


ANSWERED = frozenset({"OK", "DAMPED", "LIMITED", "UNSURE"})  # rows that have numbers


class Task(StrEnum):
    """What a correction holds first."""

    POSITION = "position"
    POSE = "pose"


class AtLimit(StrEnum):
    """What becomes of a correction that exceeds the limits."""

    SATURATE = "saturate"
    REFUSE = "refuse"


AskedTask = Annotated[
    Task | None, typer.Option(help="What is held: the position first (default), or position and orientation alike.")
]
AskedAtLimit = Annotated[
    AtLimit | None,
    typer.Option(help="Where the correction exceeds the version's limits: hold it there (default), or refuse the row."),
]
Hold = Annotated[
    list[int] | None,
    typer.Option(min=1, help="Joint, from 1, left as it is: a rail or positioner. Repeat it for more."),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Exit code 1, and write nothing, unless the status of every row is OK.")
]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter correct ur10 path.csv -o corrected.csv --version latest --strict")(correct)
    app.command(epilog="Example: kilter server status")(status)


def correct(
    robot: Robot,
    file: File,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; default is stdout.")] = None,
    column_map: ColumnMap = None,
    form: Annotated[
        str | None, typer.Option("--format", help="ros2-yaml: a ROS 2 JointTrajectory instead of the format sent.")
    ] = None,
    payload_kg: PayloadOnPath = None,
    payload_com_mm: PayloadCentre = None,
    version: Annotated[
        str | None,
        typer.Option(help="Version to correct with: id or its beginning, name, or `latest`; default: the active one."),
    ] = None,
    task: AskedTask = None,
    at_limit: AskedAtLimit = None,
    hold: Hold = None,
    strict: Strict = False,
    as_json: Json = False,
) -> None:
    """Correct a trajectory (t_s, q1_deg, ...); the answer has the format that was sent.

    dx_mm, dy_mm, dz_mm are where the uncorrected tool would be minus where it should be, along the axes of the base frame
    that the version corrects in; the command says which one that is. left_mm is what the correction leaves of it: the
    status is OK where that is within what is stated, else DAMPED or LIMITED; UNSURE is near what the version does not
    explain, or every row where its own report speaks against it. Exit code 1 when no row could be corrected.
    """
    if as_json and output is None:
        raise UsageError("--json reports what was written: name the file with -o.")
    centre = arguments.three("--payload-com-mm", payload_com_mm)
    trajectory = prepare(file, column_map=column_map)
    with on_interrupt(partial(_not_written, output)), Kilter() as kilter:
        arm = kilter.robots.get(robot)
        used = version or arm.get("active_version")
        content = kilter.correct(
            robot,
            trajectory,
            version=used,
            form=form,
            payload_kg=payload_kg,
            payload_com_mm=centre,
            task=task and task.value,
            strict=strict,
            at_limit=at_limit and at_limit.value,
            hold=hold,
        )
        found = None if used is None else kilter.versions.get(used, robot=robot)
        frames = {} if found is None else correction_frames(found)
    status = {} if form else verdicts(content, trajectory.content_type)
    _remark(content, status, as_json, lambda remark: as_json or is_note_due(kilter.url, _note_key(arm, remark)))
    if frames and not form:
        of_u95 = f" u95 is {content.u95}." if content.u95 else ""
        note(f"dx_mm, dy_mm, dz_mm are along the axes of the {frames['axes']}.{of_u95}", as_json)
    if output is None:
        typer.get_binary_stream("stdout").write(content)
    else:
        write(output, content)
        of_version = {"version_id": None if found is None else found["id"], "frames": frames}
        _show_written({"robot": robot, "output": str(output), "status": status, **of_version}, content, as_json)
    if status and not ANSWERED & set(status):
        note("Error: no row could be corrected; the column status says why.", as_json)
        raise typer.Exit(1)


def _show_written(told: dict[str, Any], content: Corrected, as_json: bool) -> None:
    rows = sum(told["status"].values())
    document = told | {
        "bytes": len(content),
        "not_corrected": list(content.left_out),
        "notes": list(content.notes),
        "u95": content.u95,
    }

    def show(_: dict[str, Any]) -> None:
        count = f"{rows} rows{content.describe_changes()}" if rows else f"{len(content)} bytes"
        print_line(f"{told['output']}: {count}; corrected with {told['version_id'] or 'no version'}.")
        print_lines(format_next("plan", "check", told["robot"]))

    emit(document, as_json, show)


def _note_key(arm: Mapping[str, Any], remark: str) -> str:
    """What a note of an arm is known by in a session of work; other commands say that of its controller too."""
    return remark if remark == arm["controller_sentence"] else f"{arm['name']}: {remark}"


def _remark(content: Corrected, status: Mapping[str, int], as_json: bool, is_due: Callable[[str], bool]) -> None:
    """Say what is not corrected, and which load was taken, but no note that was shown before."""
    left = {name: count for name, count in status.items() if name not in ANSWERED}
    if left:
        counts = ", ".join(f"{name} {count}" for name, count in left.items())
        note(f"Warning: {sum(left.values())} rows are not corrected and have empty cells ({counts}).", as_json)
    if content.left_out:
        note(f"Warning: not corrected is what {', '.join(content.left_out)} does.", as_json)
    for remark in content.notes:
        if is_due(remark):
            note(f"Note: {remark}", as_json)


def correction_frames(version: Mapping[str, Any]) -> dict[str, str]:
    """Return whose base and tool frame a version corrects in, and in words which axes an error is along."""
    found = (version.get("details") or {}).get("reference") or {}
    base, tool = found.get("base") or "robot", found.get("tool") or "robot"
    axes = "robot's base frame" if base == "robot" else "base frame as the registration found it"
    return {"base": base, "tool": tool, "axes": axes}


def _not_written(output: Path | None) -> str:
    return f"{output or 'the answer'} is not written. The server keeps nothing of a trajectory; the same command corrects it."


def verdicts(content: bytes, content_type: str) -> dict[str, int]:
    """Count the rows of each status in a corrected trajectory; nothing for Parquet without the package that reads it."""
    if content_type == CSV_TYPE:
        rows = csv.DictReader(io.StringIO(content.decode()))
        return dict(Counter(row["status"] for row in rows))
    if content_type == JSON_TYPE:
        return dict(Counter(json.loads(content)["status"]))
    try:
        from pyarrow import parquet
    except ImportError:
        return {}
    return dict(Counter(parquet.read_table(io.BytesIO(content), columns=["status"])["status"].to_pylist()))


def status(
    robot: Annotated[
        str | None, typer.Argument(help="A robot: how good it is, and its bridges.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Show whether the server is ready, how good a robot is today, and what its bridges do."""
    with Kilter() as kilter:
        document = {"url": kilter.url, **kilter.health()}
        if robot is not None:
            document["today"] = kilter.robots.today(robot)
            document["bridges"] = kilter.robots.bridges(robot)["bridges"]
    emit(document, as_json, _show_status)


def _show_status(document: dict[str, Any]) -> None:
    print_line(f"{document['url']}: {document['status']}, version {document.get('version')}")
    for name, check in document.get("checks", {}).items():
        print_line(f"  {name}: {'ok' if check['ok'] else 'not ok'} ({check['detail']})")
    if "today" in document:
        show_today(document["today"])
    for bridge in document.get("bridges", ()):
        counts = f"{bridge['cycles']} cycles, {bridge['late']} late, {bridge['lost']} lost"
        print_line(f"{bridge['sentence']} Since {bridge['since'][:19]}Z: {counts}.")
