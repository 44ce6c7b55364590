"""``kilter measure ballbar-join``, ``kilter measure tilt-join``: logs of simple instruments joined with the joint log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client.cli.files.inspect import check_numpy, fetch_joint_names
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import File, Json, PayloadCentre, Robot, three
from kilter_client.cli.terminal.output import emit, print_line, say_remarks
from kilter_client.errors import UsageError
from kilter_client.files import files_formats, files_match, files_rig
from kilter_files import read_joints

Joints = Annotated[Path, typer.Argument(help="The joint log.", metavar="JOINTS", show_default=False, exists=True)]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Where the rows go, as CSV.")]
Map = Annotated[Path | None, typer.Option(help="Column map of the joint log (TOML).", exists=True, dir_okay=False)]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command("ballbar-join", epilog="Example: kilter measure ballbar-join bar.txt joints.csv -o rows.csv")(
        ballbar_join
    )
    app.command(
        "tilt-join", epilog="Example: kilter measure tilt-join katana after.csv joints.csv --joint j3 -o readings.csv"
    )(tilt_join)


def ballbar_join(
    file: File,
    joints: Joints,
    output: Output,
    radius_mm: Annotated[
        float | None, typer.Option("--radius-mm", help="The bar's length, whatever its log says, mm.")
    ] = None,
    zero_deg: Annotated[float, typer.Option(help="Angle of the bar's zero from the robot's x axis.")] = 0.0,
    joints_map: Map = None,
    as_json: Json = False,
) -> None:
    """Join a ball bar's log with the joint log by the angle of each run: lengths with their joints, for kilter upload."""
    check_numpy()
    bar = files_formats.read_ballbar(file, radius_mm)
    table, report = files_rig.join_ballbar(bar, read_joints(joints, joints_map), zero_deg)
    write(output, table.to_csv())
    emit({"file": str(output), "notes": table.notes, "warnings": table.warnings} | report, as_json, _show)


def tilt_join(
    robot: Robot,
    file: File,
    joints: Joints,
    joint: Annotated[str, typer.Option(metavar="NAME", help="Joint before the inclinometer.")],
    output: Output,
    before: Annotated[
        Path | None,
        typer.Option(
            help="Log of the inclinometer on the link before the joint; needed where earlier joints move.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    axis: Annotated[
        Literal["x", "y", "z"], typer.Option(help="Axis of the joint frame about which it reads; z is the joint's own.")
    ] = "z",
    channel: Annotated[Literal["x", "y"], typer.Option(help="Which of its inclinations.")] = "x",
    unit: Annotated[
        str | None, typer.Option(help="Unit of its angles, whatever the log states: deg, mrad, arcmin.")
    ] = None,
    by: Annotated[
        Literal["order", "time"], typer.Option(help="How dwells are matched with rows of the joint log.")
    ] = "time",
    shortest: Annotated[float, typer.Option(help="Shortest dwell, s.")] = 0.3,
    settle: Annotated[float, typer.Option(help="Left out at the beginning of a dwell, s.")] = 0.1,
    payload_kg: Annotated[float, typer.Option(help="Payload of all readings.", min=0.0)] = 0.0,
    payload_com_mm: PayloadCentre = None,
    series: Annotated[int, typer.Option(help="Number of this mounting of the inclinometers.")] = 0,
    joints_map: Map = None,
    as_json: Json = False,
) -> None:
    """Join inclinometer logs with the joint log: one reading per rest, for kilter measure joint-parameters --readings."""
    check_numpy()
    names = [name.removesuffix(":m") for name in fetch_joint_names(robot)]
    if joint not in names:
        raise UsageError(f"--joint {joint}: the robot has {', '.join(names)}.")
    options = files_rig.TiltOptions(
        names.index(joint) + 1, axis, by, channel, unit, files_match.RestOptions(None, shortest, settle)
    )
    columns, report = files_rig.join_tilts(file, before, read_joints(joints, joints_map), names, options)
    centre = three("--payload-com-mm", payload_com_mm) or []
    place = [f"payload_com_{k}_mm" for k in "xyz"] if centre else []
    head = ["joint", "axis", *columns, "payload_kg", *place, "series"]
    rows = [
        ",".join([joint, axis, *map(_digits, row), *(f"{value:g}" for value in (payload_kg, *centre)), str(series)])
        for row in zip(*columns.values(), strict=True)
    ]
    write(output, ("\n".join([",".join(head), *rows]) + "\n").encode())
    emit({"file": str(output), "rows": report["readings"], "notes": []} | report, as_json, _show)


def _digits(value: float) -> str:
    return f"{value:.7g}" if abs(value) >= 1e-9 else "0"


def _show(document: dict[str, Any]) -> None:
    print_line(f"{document['file']}: {document['rows']} rows")
    say_remarks(document)
