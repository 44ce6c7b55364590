"""``kilter robot``: describe robots."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.arguments import Json, Robot
from kilter_client.cli.output import emit, say
from kilter_client.cli.tables import show_rows
from kilter_client.errors import FileError, UsageError

robot = typer.Typer(help="Describe robots.", no_args_is_help=True, rich_markup_mode=None)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.add_typer(robot, name="robot")


@robot.command(epilog="Example: kilter robot add robot.json")
def add(
    file: Annotated[
        Path | None, typer.Argument(help="robot.json, or a .urdf.", exists=True, dir_okay=False, show_default=False)
    ] = None,
    preset: Annotated[str | None, typer.Option(help="A robot that ships with Kilter, instead of a file.")] = None,
    name: Annotated[str | None, typer.Option(help="Name to give it; needed for a URDF.")] = None,
    base_link: Annotated[str | None, typer.Option(help="URDF: first link of the chain.")] = None,
    tip_link: Annotated[str | None, typer.Option(help="URDF: last link of the chain.")] = None,
    as_json: Json = False,
) -> None:
    """Add a robot from robot.json, from a URDF, or from a preset."""
    document = _document(file, preset, name, base_link, tip_link)
    with Kilter() as kilter:
        emit(kilter.robots.add(document), as_json, _show)


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


def _document(
    file: Path | None, preset: str | None, name: str | None, base_link: str | None, tip_link: str | None
) -> dict[str, Any]:
    if (file is None) == (preset is None):
        raise UsageError("Give either a FILE or --preset.")
    is_urdf = file is not None and file.suffix.lower() in (".urdf", ".xml")
    if (base_link or tip_link) and not is_urdf:
        raise UsageError("--base-link and --tip-link belong to a .urdf file.")
    if file is None:
        return {"name": name or preset, "convention": "preset", "preset": preset}
    if not is_urdf:
        document = _json(file)
        return {**document, "name": name} if name else document
    if not (name and base_link and tip_link):
        raise UsageError("A URDF needs --name, --base-link and --tip-link: it may hold a bigger tree than the arm.")
    text = _text(file)
    return {"name": name, "convention": "urdf", "urdf": text, "base_link": base_link, "tip_link": tip_link}


def _json(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(_text(file))
    except ValueError as error:
        raise FileError(f"{file}: is no JSON ({error}).", file=str(file)) from error
    if not isinstance(document, dict):
        raise FileError(f"{file}: is no JSON object. Describe one robot, see the robots reference.", file=str(file))
    return document


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{file}: cannot be read as text ({error}).", file=str(file)) from error


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
    for note in document.get("notes", ()):
        say(f"note: {note}")


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
