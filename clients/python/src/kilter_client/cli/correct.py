"""``kilter correct``: a trajectory in, the corrected one out."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.arguments import File, Json, Robot
from kilter_client.cli.interrupt import on_interrupt
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
    """Correct a trajectory (t_s, q1_deg, ...) with the active version; the answer has the format that was sent.

    dx_mm, dy_mm, dz_mm are where the uncorrected tool would be minus where it should be, along the axes of the base frame
    that the version corrects in; the command says which one that is. Exit code 1 when no row could be corrected.
    """
    if as_json and output is None:
        raise UsageError("--json reports what was written: name the file with -o.")
    trajectory = prepare(file, column_map=column_map)
    with on_interrupt(partial(_not_written, output)), Kilter() as kilter:
        version = kilter.robots.get(robot).get("active_version")
        content = kilter.correct(robot, trajectory, version=version, form=form)
        frames = {} if version is None else frames_of(kilter.versions.get(version))
    status = {} if form else verdicts(content, trajectory.content_type)
    left = {name: count for name, count in status.items() if name != "OK"}
    if left:
        counts = ", ".join(f"{name} {count}" for name, count in left.items())
        note(f"Warning: {sum(left.values())} rows are not corrected and have empty cells ({counts}).", as_json)
    if content.left_out:
        note(f"Warning: not corrected is what {', '.join(content.left_out)} does.", as_json)
    refused = bool(status) and not status.get("OK")
    if frames and not form:
        note(f"dx_mm, dy_mm, dz_mm are along the axes of the {frames['axes']}.", as_json)
    if output is None:
        typer.get_binary_stream("stdout").write(content)
        raise typer.Exit(1 if refused else 0)
    write(output, content)
    document = {
        "robot": robot,
        "output": str(output),
        "bytes": len(content),
        "status": status,
        "version_id": version,
        "frames": frames,
        "not_corrected": list(content.left_out),
    }
    emit(
        document,
        as_json,
        lambda _: say(f"{output}: {sum(status.values()) or len(content)} {'rows' if status else 'bytes'}"),
    )
    if refused:
        note("Error: no row could be corrected; the column status says why.", as_json)
        raise typer.Exit(1)


def frames_of(version: Mapping[str, Any]) -> dict[str, str]:
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


def status(as_json: Json = False) -> None:
    """Show whether the server is ready."""
    with Kilter() as kilter:
        document = {"url": kilter.url, **kilter.health()}
    emit(document, as_json, _show_status)


def _show_status(document: dict[str, Any]) -> None:
    say(f"{document['url']}: {document['status']}, version {document.get('version')}")
    for name, check in document.get("checks", {}).items():
        say(f"  {name}: {'ok' if check['ok'] else 'not ok'} ({check['detail']})")
