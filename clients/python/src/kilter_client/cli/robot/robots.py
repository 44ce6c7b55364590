"""``kilter robot``: describe robots."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.robot import circles
from kilter_client.cli.robot.arm_figure import save_arm
from kilter_client.cli.robot.drawing import show_check
from kilter_client.cli.robot.robot_file import RobotSource, takes_a_robot
from kilter_client.cli.stored import keeping
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import Json, Retired, Robot
from kilter_client.cli.terminal.output import emit, note, print_line
from kilter_client.cli.terminal.tables import show_rows
from kilter_client.errors import UsageError


class Compensation(StrEnum):
    """How a controller corrects by itself."""

    none = "none"
    factory = "factory"
    kilter = "kilter"
    unknown = "unknown"


robot = typer.Typer(help="Describe robots.", no_args_is_help=True, rich_markup_mode=None, cls=Group)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    circles.register(robot)
    keeping.register_robot(robot)
    app.add_typer(robot, name="robot")


@robot.command(epilog="Example: kilter robot add robot.json")
@takes_a_robot
def add(
    source: RobotSource,
    controller_compensation: Annotated[
        Compensation | None,
        typer.Option(
            help="Whether the controller corrects the arm by itself; unknown where neither this nor FILE says."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Add a robot from robot.json, another tool's file, or a preset."""
    document = source.document()
    if controller_compensation is not None:
        document = {**document, "controller_compensation": controller_compensation.value}
    with Kilter() as kilter:
        emit(kilter.robots.add(document), as_json, _show)
        for line in () if as_json else kilter.robots.check(document)["suspicious"]:
            print_line(f"suspicious: {line}")


@robot.command(epilog="Example: kilter robot check arm.csv --name arm --convention dh --plot arm.png")
@takes_a_robot
def check(
    source: RobotSource,
    plot: Annotated[Path | None, typer.Option(help="Draw the arm into this .png or .svg file too.")] = None,
    as_json: Json = False,
) -> None:
    """Draw and check a robot: it at zero, axes, limits, reach, what looks wrong; nothing is added."""
    if plot is not None and plot.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--plot {plot}: give a file that ends in .png or .svg.")
    document = source.document(source.file.stem if source.file else None)
    with Kilter() as kilter:
        found = kilter.robots.check(document)
    if plot is not None:
        save_arm(plot, found)
    emit(found, as_json, show_check)


@robot.command(epilog="Example: kilter robot convert arm.csv --name arm --convention dh --to mcpc -o arm.json")
@takes_a_robot
def convert(
    source: RobotSource,
    to: Annotated[str, typer.Option(metavar="CONVENTION", help="chain, dh, mdh, s_model, poe, cpc, mcpc or urdf.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="File to write, .json or .urdf; without it the document is printed."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a robot in another convention: the same poses at the same joint readings; nothing is added."""
    document = source.document(source.file.stem if source.file and source.file.suffix != ".json" else None)
    with Kilter() as kilter:
        found = kilter.robots.convert(document, to)
    if output is not None:
        text = found["urdf"] if output.suffix == ".urdf" and to == "urdf" else json.dumps(found, indent=1) + "\n"
        write(output, text.encode())
        note(f"{output}: {to}", as_json)
        found = {**found, "file": str(output)} if as_json else found
    emit(found, as_json, say_document if output is None else lambda _: None)


@robot.command(epilog="Example: kilter robot compensation ur10 none")
def compensation(
    robot: Robot,
    compensation: Annotated[
        Compensation, typer.Argument(metavar="none|factory|kilter|unknown", help="How it corrects.", show_default=False)
    ],
    as_json: Json = False,
) -> None:
    """Say whether the controller corrects the arm by itself.

    Nothing is then corrected twice. none; factory: by its maker's calibration; kilter: by a calibration that Kilter exported.
    """
    with Kilter() as kilter:
        emit(
            kilter.robots.compensation(robot, compensation.value),
            as_json,
            lambda found: print_line(found["controller_sentence"]),
        )


@robot.command("list", epilog="Example: kilter robot list")
def list_(retired: Retired = False, as_json: Json = False) -> None:
    """List the robots."""
    with Kilter() as kilter:
        document = {"robots": kilter.robots.list(retired)}
    emit(document, as_json, _show_list)


@robot.command(epilog="Example: kilter robot show katana450")
def show(robot: Robot, as_json: Json = False) -> None:
    """Show a robot: joints, limits, and the names of its parameters."""
    with Kilter() as kilter:
        emit(kilter.robots.get(robot), as_json, _show)


def say_document(document: dict[str, Any]) -> None:
    """Print a robot document as it would stand in its file."""
    print_line(json.dumps(document, indent=1))


def _show(document: dict[str, Any]) -> None:
    print_line(
        f"{document['name']} ({document['convention']}), active version: {document.get('active_version') or 'none'}"
    )
    rows = [
        (
            str(number),
            joint["name"],
            joint["kind"],
            _limits(joint),
            "" if joint.get("gear_ratio") is None else f"{joint['gear_ratio']:g}",
        )
        for number, joint in enumerate(document.get("joints", ()), 1)
    ]
    show_rows(("", "joint", "kind", "limits", "gear ratio"), rows)
    print_line(document["controller_sentence"])
    print_line(f"parameters: {', '.join(document.get('parameters', ())) or 'none'}")
    load = (document.get("document") or {}).get("load")
    if load:
        centre = ", ".join(f"{value:g}" for value in load.get("payload_com_mm") or (0, 0, 0))
        print_line(f"default load: {load['payload_kg']:g} kg at ({centre}) mm in the tool frame")
    if document.get("remarks"):
        print_line(f"remarks: {document['remarks']}")
    for remark in document.get("notes", ()):
        print_line(f"note: {remark}")


def _limits(joint: dict[str, Any]) -> str:
    unit = "deg" if joint.get("limits_deg") else "mm"
    low, high = joint.get(f"limits_{unit}") or (None, None)
    if low is None and high is None:
        return "none"
    return f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'} {unit}"


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (
            r["name"] + (" (retired)" if r.get("retired_at") else ""),
            r["convention"],
            str(r["campaigns"]),
            str(r["versions"]),
            r.get("active_version") or "none",
            r.get("controller_compensation") or "unknown",
        )
        for r in document["robots"]
    ]
    show_rows(("robot", "convention", "campaigns", "versions", "active", "controller"), rows)
