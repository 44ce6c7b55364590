"""``kilter correct``: a trajectory in, the corrected one out."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.arguments import File, Json, Robot
from kilter_client.cli.output import emit, note, say
from kilter_client.cli.versions import write
from kilter_client.errors import UsageError
from kilter_files import prepare
from kilter_files.table import CSV_TYPE, JSON_TYPE


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter correct ur10 path.csv -o corrected.csv")(correct)
    app.command(epilog="Example: kilter status")(status)


def correct(
    robot: Robot,
    file: File,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; default is stdout.")] = None,
    column_map: Annotated[
        Path | None, typer.Option("--map", help="Column map of a lab's own file (TOML).", exists=True, dir_okay=False)
    ] = None,
    form: Annotated[
        str | None, typer.Option("--format", help="ros2-yaml: a ROS 2 JointTrajectory instead of the format sent.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Correct a trajectory (t_s, q1_deg, ...) with the active version; the answer has the format that was sent."""
    if as_json and output is None:
        raise UsageError("--json reports what was written: name the file with -o.")
    trajectory = prepare(file, column_map=column_map)
    with Kilter() as kilter:
        content = kilter.correct(robot, trajectory, form=form)
    status = {} if form else verdicts(content, trajectory.content_type)
    left = {name: count for name, count in status.items() if name != "OK"}
    if left:
        counts = ", ".join(f"{name} {count}" for name, count in left.items())
        note(f"Warning: {sum(left.values())} rows are not corrected and have empty cells ({counts}).", as_json)
    if content.left_out:
        note(f"Warning: not corrected is what {', '.join(content.left_out)} does.", as_json)
    if output is None:
        typer.get_binary_stream("stdout").write(content)
        return
    write(output, content)
    document = {
        "robot": robot,
        "output": str(output),
        "bytes": len(content),
        "status": status,
        "not_corrected": list(content.left_out),
    }
    emit(
        document,
        as_json,
        lambda _: say(f"{output}: {sum(status.values()) or len(content)} {'rows' if status else 'bytes'}"),
    )


def verdicts(content: bytes, content_type: str) -> dict[str, int]:
    """Count the rows of each status in a corrected trajectory; nothing for Parquet, which needs a package to read."""
    if content_type == CSV_TYPE:
        rows = csv.DictReader(io.StringIO(content.decode()))
        return dict(Counter(row["status"] for row in rows))
    if content_type == JSON_TYPE:
        return dict(Counter(json.loads(content)["status"]))
    return {}


def status(as_json: Json = False) -> None:
    """Show whether the server is ready."""
    with Kilter() as kilter:
        document = {"url": kilter.url, **kilter.health()}
    emit(document, as_json, _show_status)


def _show_status(document: dict[str, Any]) -> None:
    say(f"{document['url']}: {document['status']}, version {document.get('version')}")
    for name, check in document.get("checks", {}).items():
        say(f"  {name}: {'ok' if check['ok'] else 'not ok'} ({check['detail']})")
