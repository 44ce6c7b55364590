"""``kilter robot episodes``: joints that stand elsewhere from one episode of a LeRobot data set to the next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client.cli.files.inspect import Calibration, JointOrder, NormMode, check_numpy
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.files import files_formats
from kilter_files.formats import LogHints

MOVED = 3  # exit code, as of `kilter check`
UNTOLD = (
    "A data set counts readings and goals from the zeros of the servos: a zero that was off from the first episode on, and "
    "backlash or sag behind a servo, are not in it. Measure those with a camera: kilter measure see."
)
MEANS = {
    "zero": "its zero moved (calibrated anew, a horn that slipped, another motor), or it was moved differently from then on",
    "posture": "it was parked or moved differently; its zero did not move, else all of it would have",
    "rotation": "its servo counts from another rotation: it wraps within its range (calibrate the arm in the middle of its "
    "range and record again), or it was rotated from one end of its range to the other",
    "lag": "it stays behind its goal by another amount: load, gain or friction of the servo; its zero does not show in this",
}
SIGNALS = {"start": "start", "end": "end", "low": "lowest", "high": "highest", "lag": "lag at rest"}


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter robot episodes my-set --norm-mode DEGREES")(episodes)


def episodes(
    dataset: Annotated[
        Path, typer.Argument(help="Folder of a LeRobot data set.", metavar="FOLDER", exists=True, show_default=False)
    ],
    norm_mode: NormMode = None,
    calibration: Calibration = None,
    joint_order: JointOrder = None,
    least_deg: Annotated[float, typer.Option(help="Smallest jump that is named, degrees.", min=0.1)] = 2.0,
    as_json: Json = False,
) -> None:
    """Name the joints that stand elsewhere from one episode to the next: exit code 0 none, 3 a zero may have moved.

    A data set that is half written, whose videos have other lengths than its rows, or in which a servo wraps is refused.
    """
    check_numpy()
    order = arguments.split_names([joint_order or ""])
    found = files_formats.read_episodes(dataset, LogHints(None, order, calibration=calibration, norm_mode=norm_mode))
    moves = [
        vars(move) | {"signals": list(move.signals), "means": MEANS[move.what]}
        for move in files_formats.detect_joint_moves(found, least_deg)
    ]
    document = {
        "dataset": str(dataset),
        "episodes": len(found.numbers),
        "joints": list(found.joints),
        "least_deg": least_deg,
        "moves": moves,
        "untold": UNTOLD,
    }
    emit(document, as_json, _show)
    if any(move["what"] in ("zero", "rotation") for move in moves):
        raise typer.Exit(MOVED)


def _show(document: Mapping[str, Any]) -> None:
    for move in document["moves"]:
        signals = ", ".join(SIGNALS[name] for name in move["signals"])
        between = f"between episodes {move['before']} and {move['after']}"
        scatter = f"single episodes scatter by {move['scatter_deg']:.1f} deg"
        print_line(
            f"{move['joint']} moved by {move['by_deg']:+.1f} deg {between} ({signals}; {scatter}): {move['means']}."
        )
    if not document["moves"]:
        print_line(f"No joint moved by {document['least_deg']:g} deg or more over {document['episodes']} episodes.")
    print_line(document["untold"])
