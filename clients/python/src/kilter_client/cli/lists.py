"""``kilter server effects | methods | presets | formats | columns``: what there is, one line each, without a server."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import typer

from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import Document, emit, note, show_rows
from kilter_files.formats import list_formats
from kilter_files.ground import column_unit
from kilter_files.robots import KATANA, TABLES, UR, URDF

LISTS: dict[str, list[dict[str, str]]] = json.loads(
    Path(__file__).with_name("texts").joinpath("lists.json").read_text(encoding="utf-8")
)  # written by `make contract`: change it where it stands
OF_THIS_RELEASE = "These are of this release of the command; a server of another release may have others."


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter server effects")(effects)
    app.command(epilog="Example: kilter server methods")(methods)
    app.command(epilog="Example: kilter robot presets")(presets)
    app.command(epilog="Example: kilter measure formats")(formats)
    app.command(epilog="Example: kilter measure columns")(columns)


def effects(as_json: Json = False) -> None:
    """List the physical effects that can be identified: what each is, where it acts, and what rows or robot must hold.

    The list is that of this release of the command; no server is asked.
    """
    _show(
        "effects",
        LISTS["effects"],
        ("id", "acts_on", "needs", "summary"),
        ("effect", "acts on", "needs", "what"),
        as_json,
    )
    note(f"Use: kilter identify ROBOT --effects clearance_tilt,backlash. {OF_THIS_RELEASE}", as_json)


def methods(as_json: Json = False) -> None:
    """List the methods of an identification.

    The list is that of this release of the command; no server is asked.
    """
    _show("methods", LISTS["methods"], ("id", "summary"), ("method", "what"), as_json)
    note(f"Use: kilter identify ROBOT --method kalman. {OF_THIS_RELEASE}", as_json)


def presets(as_json: Json = False) -> None:
    """List the robots that ship with Kilter, and where their values come from.

    The list is that of this release of the command; no server is asked.
    """
    head = ("preset", "joints", "convention", "masses", "source")
    rows = [
        {**preset, "source": preset["source"] if as_json else _first_clause(preset["source"])}
        for preset in LISTS["presets"]
    ]
    _show("presets", rows, ("id", *head[1:]), head, as_json)
    note(f"Use: kilter robot add --preset ur10 --name my-arm. {OF_THIS_RELEASE}", as_json)


def formats(as_json: Json = False) -> None:
    """List the files that are read and written, with their endings and the command that takes them."""
    _show("formats", list(_formats()), ("use", "id", "endings", "what"), ("use", "format", "endings", "what"), as_json)
    note("`kilter measure inspect FILE` shows how it reads a file.", as_json)


def columns(as_json: Json = False) -> None:
    """List the columns of measurements, with their units.

    The list is that of this release of the command; no server is asked.
    """
    rows = []
    for column in LISTS["columns"]:
        units = dict.fromkeys(column_unit(name) for name in re.findall(r"\w+", column["columns"]))
        rows.append({**column, "unit": ", ".join(unit for unit in units if unit)})
    if not as_json:
        rows = [{**row, "meaning": _first_clause(row["meaning"])} for row in rows]
    _show("columns", rows, ("columns", "unit", "meaning"), ("columns", "unit", "meaning"), as_json)
    note("For other names and units use a column map: `kilter measure inspect FILE --draft columns.toml`.", as_json)


def _formats() -> Iterator[dict[str, str]]:
    for use, name, endings, title in list_formats():
        yield _format(use, name, endings, title)
    robots = (("json", (".json",), "robot.json"), ("urdf", URDF, "URDF"), ("table", TABLES, "DH or MDH table"))
    others = (("universal", UR, "calibration of Universal Robots"), ("katana", KATANA, "configuration of a Katana"))
    for name, endings, title in (*robots, *others):
        yield _format("robot add", name, endings, title)
    for export in LISTS["exports"]:
        yield _format("export --format", export["id"], (export["ending"],), "a version for other programs")


def _format(use: str, name: str, endings: Sequence[str], what: str) -> dict[str, str]:
    return {"use": use, "id": name, "endings": " ".join(endings), "what": what.rstrip(".")}


def _show(name: str, rows: Sequence[dict[str, str]], keys: Sequence[str], head: Sequence[str], as_json: bool) -> None:
    document: Document = {name: list(rows)}
    emit(document, as_json, lambda _: show_rows(head, [tuple(row[key] for key in keys) for row in rows]))


def _first_clause(text: str) -> str:
    """Return what stands before the first full stop or semicolon that ends a thought."""
    return text.replace(". ", "; ").split("; ", 1)[0].split(" (", 1)[0] if len(text) > 90 else text
