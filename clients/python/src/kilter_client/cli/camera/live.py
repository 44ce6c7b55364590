"""``kilter measure live``: a page with the camera's picture that takes views when the arm rests."""

from __future__ import annotations

import json
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import typer

from kilter_client.cli.files.inspect import check_numpy
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, note, print_line
from kilter_client.errors import UsageError
from kilter_client.files import files_rig


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure live /dev/video0 --board board.json --joints now.csv -o pictures")(live)


def live(
    source: Annotated[
        str,
        typer.Argument(
            help="A folder that fills, the address of an MJPEG stream, or a camera (/dev/video0).", show_default=False
        ),
    ],
    board: Annotated[
        list[Path],
        typer.Option(
            help="JSON of the board, from kilter measure board; repeat for more.", exists=True, dir_okay=False
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Where pictures go; a folder's stay where they are."),
    ] = None,
    joints: Annotated[
        Path | None,
        typer.Option(
            help="A file that says where the arm is now: its last row is noted with each view.", dir_okay=False
        ),
    ] = None,
    views: Annotated[int | None, typer.Option(min=1, help="End after so many views.")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any that is free.")] = 0,
    as_json: Json = False,
) -> None:
    """Show a camera's picture on a page of this machine, with corners and what is missing, and take views at rest."""
    check_numpy()
    targets = [files_rig.read_target(path) for path in board]
    files_rig.check_apart(targets)
    feed, stop = files_rig.open_feed(source), Event()
    if output is None and not isinstance(feed, files_rig.Folder):
        raise UsageError("Say where pictures go: -o DIR.")
    if joints is not None and output is None:
        raise UsageError("--joints writes a table beside the pictures: say where they go, -o DIR.")
    session = files_rig.Session(files_rig.Looker(targets), files_rig.Taken(output, joints), feed.name, wanted=views)
    with files_rig.serve_live_page(session, port) as address:
        # Told at once, for the document comes when the page has gone; stdout keeps to that one document.
        note(json.dumps({"address": address}) if as_json else f"{address}  (end with Ctrl-C)")
        try:
            files_rig.follow(session, files_rig.newest(feed, stop))
        except KeyboardInterrupt:
            pass  # the usual end
        finally:
            stop.set()
    emit({"address": address, **_session_document(session, output, joints, source, board)}, as_json, _show)


def _session_document(
    session: Any, output: Path | None, joints: Path | None, source: str, board: list[Path]
) -> dict[str, Any]:
    where = source if output is None else str(output)
    boards = " ".join(f"--board {path}" for path in board)
    table = f" --joints {Path(where) / 'joints.csv'}" if joints is not None else ""
    return {
        "views": session.taken.names,
        "pictures": session.numbers,
        "gates": session.gates,
        "folder": where,
        "next": f"kilter measure see {where} {boards}{table} -o views.csv",
    }


def _show(document: dict[str, Any]) -> None:
    print_line(f"{len(document['views'])} views of {document['pictures']} pictures in {document['folder']}")
    for gate in document["gates"]:
        if not gate["met"]:
            print_line(f"  Missing: {gate['remedy']}")
    print_line(f"  Next: {document['next']}")
