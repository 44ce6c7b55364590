"""``kilter robot``: describe robots."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli import circles
from kilter_client.cli.arguments import Json, Robot
from kilter_client.cli.drawing import show_check
from kilter_client.cli.output import emit, note, say
from kilter_client.cli.picture import picture
from kilter_client.cli.tables import show_rows
from kilter_client.cli.versions import write
from kilter_client.errors import UsageError
from kilter_client.robots import Described, read_robot

robot = typer.Typer(help="Describe robots.", no_args_is_help=True, rich_markup_mode=None)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    circles.register(robot)
    app.add_typer(robot, name="robot")


ROBOT_FILE = "robot.json, .urdf, a DH table (.csv, .xlsx), a UR calibration (.yaml), or a KNI .cfg."
RobotFile = Annotated[Path | None, typer.Argument(help=ROBOT_FILE, exists=True, dir_okay=False, show_default=False)]
Preset = Annotated[str | None, typer.Option(help="A robot that ships with Kilter, instead of a file.")]
Name = Annotated[str | None, typer.Option(help="Name to give it; only robot.json has one.")]
BaseLink = Annotated[str | None, typer.Option(help="URDF: first link of the chain.")]
TipLink = Annotated[str | None, typer.Option(help="URDF: last link of the chain.")]
Convention = Annotated[str | None, typer.Option(help="Table: dh or mdh (Craig).", metavar="dh|mdh")]
Model = Annotated[str | None, typer.Option(help="UR calibration: the model it must be of, for example ur10e.")]
Turned = Annotated[list[str] | None, typer.Option(help="A joint the controller counts backwards; repeat for more.")]
Follows = Annotated[
    list[str] | None,
    typer.Option(help="A joint read against the horizontal, as FANUC's: j3=j2; repeat for more.", metavar="J3=J2"),
]


@robot.command(epilog="Example: kilter robot add robot.json")
def add(
    file: RobotFile = None,
    preset: Preset = None,
    name: Name = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    convention: Convention = None,
    model: Model = None,
    turned: Turned = None,
    follows: Follows = None,
    as_json: Json = False,
) -> None:
    """Add a robot from robot.json, from a file of another tool, or from a preset."""
    described = Described(name, base_link, tip_link, convention, model, turned or (), follows or ())
    document = _document(file, preset, described)
    with Kilter() as kilter:
        emit(kilter.robots.add(document), as_json, _show)


@robot.command(epilog="Example: kilter robot check arm.csv --name arm --convention dh --plot arm.png")
def check(
    file: RobotFile = None,
    preset: Preset = None,
    name: Name = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    convention: Convention = None,
    model: Model = None,
    turned: Turned = None,
    follows: Follows = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the arm into this .png file too.")] = None,
    as_json: Json = False,
) -> None:
    """Draw a robot at zero and list axes, limits, reach and what looks wrong; nothing is added."""
    described = Described(
        name or (file.stem if file else None), base_link, tip_link, convention, model, turned or (), follows or ()
    )
    if plot is not None and plot.suffix.lower() != ".png":
        raise UsageError(f"--plot {plot}: give a file that ends in .png.")
    document = _document(file, preset, described)
    with Kilter() as kilter:
        found = kilter.robots.check(document)
    if plot is not None:
        write(plot, picture(found))
    emit(found, as_json, show_check)


@robot.command(epilog="Example: kilter robot convert arm.csv --name arm --convention dh --to mcpc -o arm.json")
def convert(
    to: Annotated[str, typer.Option(metavar="CONVENTION", help="chain, dh, mdh, s_model, poe, cpc, mcpc or urdf.")],
    file: RobotFile = None,
    preset: Preset = None,
    name: Name = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    convention: Convention = None,
    model: Model = None,
    turned: Turned = None,
    follows: Follows = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="File to write.")] = None,
    as_json: Json = False,
) -> None:
    """Write a robot in another convention: the same poses at the same joint readings; nothing is added."""
    described = Described(
        name or (file.stem if file and file.suffix != ".json" else None),
        base_link,
        tip_link,
        convention,
        model,
        turned or (),
        follows or (),
    )
    document = _document(file, preset, described)
    with Kilter() as kilter:
        found = kilter.robots.convert(document, to)
    if output is not None:
        text = found["urdf"] if output.suffix == ".urdf" and to == "urdf" else json.dumps(found, indent=1) + "\n"
        write(output, text.encode())
        note(f"{output}: {to}", as_json)
        found = {**found, "file": str(output)} if as_json else found
    emit(found, as_json, say_document if output is None else lambda _: None)


@robot.command("list", epilog="Example: kilter robot list")
def list_(as_json: Json = False) -> None:
    """List the robots."""
    with Kilter() as kilter:
        document = {"robots": kilter.robots.list()}
    emit(document, as_json, _show_list)


@robot.command(epilog="Example: kilter robot show katana450")
def show(robot: Robot, as_json: Json = False) -> None:
    """Show a robot: joints, limits, and the names of its parameters."""
    with Kilter() as kilter:
        emit(kilter.robots.get(robot), as_json, _show)


def _document(file: Path | None, preset: str | None, described: Described) -> dict[str, Any]:
    if (file is None) == (preset is None):
        raise UsageError("Give either a FILE or --preset.")
    if file is not None:
        return read_robot(file, described)
    if replace(described, name=None) != Described():
        raise UsageError(
            "A preset is whole: --tip-link and --base-link belong to a .urdf file, the others to other files."
        )
    return {"name": described.name or preset, "convention": "preset", "preset": preset}


def say_document(document: dict[str, Any]) -> None:
    """Print a robot document as it would stand in its file."""
    say(json.dumps(document, indent=1))


def _show(document: dict[str, Any]) -> None:
    say(f"{document['name']} ({document['convention']}), active version: {document.get('active_version') or 'none'}")
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
    say(f"parameters: {', '.join(document.get('parameters', ())) or 'none'}")
    for remark in document.get("notes", ()):
        say(f"note: {remark}")


def _limits(joint: dict[str, Any]) -> str:
    unit = "deg" if joint.get("limits_deg") else "mm"
    low, high = joint.get(f"limits_{unit}") or (None, None)
    if low is None and high is None:
        return "none"
    return f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'} {unit}"


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (r["name"], r["convention"], str(r["campaigns"]), str(r["versions"]), r.get("active_version") or "none")
        for r in document["robots"]
    ]
    show_rows(("robot", "convention", "campaigns", "versions", "active"), rows)
