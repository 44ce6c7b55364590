"""``kilter measure board``: a board to print for a camera."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.errors import UsageError
from kilter_files.rig import USUAL, Board, check_board, check_cube, save_board, save_cube


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure board --columns 8 --rows 6 --square-mm 30 -o board.pdf")(board)


def board(
    columns: Annotated[int, typer.Option(help="Squares from left to right.")],
    rows: Annotated[int, typer.Option(help="Squares from top to bottom.")],
    square_mm: Annotated[float, typer.Option("--square-mm", help="Side of a square; also from tag to tag.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="board.pdf or board.svg; board.json comes beside it.")
    ],
    kind: Annotated[
        Literal["charuco", "apriltag"], typer.Option(help="A chessboard with markers, or tags alone.")
    ] = "charuco",
    marker_mm: Annotated[
        float | None, typer.Option("--marker-mm", help="Side of a marker; default: 0.75 of a square.")
    ] = None,
    dictionary: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="As OpenCV names it, 6x6_250; default 5x5_1000, of tags apriltag_36h11."),
    ] = None,
    first_id: Annotated[
        int, typer.Option("--first-id", help="Number of its first marker: boards in one picture need numbers apart.")
    ] = 0,
    page: Annotated[
        Literal["a4", "a3", "a2", "a1", "a0", "letter"] | None,
        typer.Option(help="Paper; default: the smallest A page on which it fits."),
    ] = None,
    cube: Annotated[
        bool,
        typer.Option("--cube", help="A cube with such a board on all faces, as a net; columns and rows are equal."),
    ] = False,
    edge_mm: Annotated[
        float | None,
        typer.Option("--edge-mm", help="Edge of the cube; default: the board and half a square of white around it."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a board to print for a camera, in true mm with rulers, and its description as JSON."""
    side = 0.75 * square_mm if marker_mm is None else marker_mm
    made = Board(kind, columns, rows, square_mm, side, dictionary or USUAL[kind], first_id)
    if edge_mm is not None and not cube:
        raise UsageError("--edge-mm is the edge of a cube: give --cube too.")
    solid = check_cube(made, edge_mm) if cube else None
    document = save_cube(solid, output, page) if solid else save_board(check_board(made), output, page)
    files = {"file": str(output), "description": str(output.with_suffix(".json"))}
    emit(files | document, as_json, _show)


def _show(document: dict[str, Any]) -> None:
    page, rulers = document["page"], document["rulers_mm"]
    size = f"{page['name'].upper()}, {len(document['markers'])} markers, {len(document['corners'])} corners"
    print_line(f"{document['file']}: {size}; described in {document['description']}")
    lengths = f"{rulers['across']:g} mm across and {rulers['upright']:g} mm upright"
    print_line(f"  Print it at 100 % and measure both rulers: {lengths}.")
