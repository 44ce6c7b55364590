"""``kilter robot torque``: a path in, the torques that it needs out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kilter_client import Kilter
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import ColumnMap, File, Json, PayloadCentre, PayloadOnPath, Robot
from kilter_client.cli.terminal.output import emit, note, print_line
from kilter_client.errors import UsageError
from kilter_files import prepare


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter robot torque ur10 path.csv -o with-torques.csv --payload-kg 2")(torque)


def torque(
    robot: Robot,
    file: File,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; default is stdout.")] = None,
    column_map: ColumnMap = None,
    version: Annotated[
        str | None,
        typer.Option(help="Version to take torques of; default: the active one, else the newest search in torques."),
    ] = None,
    search: Annotated[str | None, typer.Option(help="Search in torques to take instead: id or name.")] = None,
    payload_kg: PayloadOnPath = None,
    payload_com_mm: PayloadCentre = None,
    as_json: Json = False,
) -> None:
    """Tell the torques that a path (t_s, q1_deg, ...) needs; the answer has the format that was sent.

    They are those of gravity, inertia and friction as a log of torques showed them (kilter gap, identify): feed-forward for a
    controller, or what to compare its own model with. Columns qd1_deg_s and qdd1_deg_s are taken where the path has them.
    """
    if as_json and output is None:
        raise UsageError("--json reports what was written: name the file with -o.")
    centre = arguments.three("--payload-com-mm", payload_com_mm)
    with Kilter() as kilter:
        content = kilter.torques(
            robot,
            prepare(file, column_map=column_map),
            search=search,
            version=version,
            payload_kg=payload_kg,
            payload_com_mm=centre,
        )
    for remark in content.notes:
        note(f"Note: {remark}", as_json)
    if output is None:
        typer.get_binary_stream("stdout").write(content)
        return
    write(output, content)
    document = {"robot": robot, "output": str(output), "bytes": len(content), "notes": list(content.notes)}
    emit(
        document,
        as_json,
        lambda told: print_line(f"{told['output']}: the path with its torques, {told['bytes']} bytes."),
    )
