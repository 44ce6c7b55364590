"""``kilter measure inspect``: how a file is read, before anything is sent."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, print_line, show_rows
from kilter_client.errors import UsageError
from kilter_files import draft
from kilter_files import inspect as look
from kilter_files.formats import PRESETS, LogHints
from kilter_files.ground.later import need


def fetch_joint_names(robot: str | None) -> list[str]:
    """Return the joint names of a robot of the server, for logs that name them; prismatic ones end in ``:m``."""
    if robot is None:
        return []
    with Kilter() as kilter:
        joints = kilter.robots.get(robot)["joints"]
    return [joint["name"] + (":m" if joint["kind"] == "prismatic" else "") for joint in joints]


MARKERS_SHOWN = 12

Rate = Annotated[float | None, typer.Option("--rate", help="Frames per second, where the file does not say.")]
Unit = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of the coordinates or angles, whatever the file states: mm, m, inch, mrad."),
]
AllowCut = Annotated[bool, typer.Option("--allow-cut", help="Use the complete frames of a truncated file.")]
Topic = Annotated[str | None, typer.Option("--topic", help="Bag: the topic of the joint states, if there are several.")]
JointOrder = Annotated[
    str | None,
    typer.Option(
        "--joint-order",
        metavar="A,B",
        help="Bag: the arm's joints from the base to the tool; a prismatic one is NAME:m.",
    ),
]
Calibration = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="JSON",
        help="LeRobot: the calibration of the arm that recorded the data set.",
        exists=True,
        dir_okay=False,
    ),
]
NormMode = Annotated[
    Literal["RANGE_M100_100", "DEGREES"] | None,
    typer.Option("--norm-mode", help="LeRobot: what its numbers are, parts of the range or degrees."),
]
Zero = Annotated[
    Literal["new", "old"],
    typer.Option("--zero", help="LeRobot: old where the arm was stretched out at zero (recorded before LeRobot 0.2)."),
]
FileOrBag = Annotated[
    Path, typer.Argument(help="The file, or a bag's folder.", metavar="FILE", show_default=False, exists=True)
]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure inspect recording.c3d")(inspect)


def inspect(
    file: FileOrBag,
    rate: Rate = None,
    allow_cut: AllowCut = False,
    preset: Annotated[
        str, typer.Option(help="Origin of the text export: leica, faro, spatialanalyzer, polyworks, generic.")
    ] = "generic",
    euler: Annotated[
        str | None, typer.Option(help="Order of its angles: XYZ about the moving axes, xyz about the fixed ones.")
    ] = None,
    unit: Unit = None,
    topic: Topic = None,
    joint_order: JointOrder = None,
    calibration: Calibration = None,
    norm_mode: NormMode = None,
    zero: Zero = "new",
    draft: Annotated[
        Path | None,
        typer.Option(
            "--draft",
            metavar="MAP",
            help="Write a first column map there; what could not be determined is marked ?.",
            dir_okay=False,
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", help="The arm, whose joints the columns may be named after."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Show what is understood of a file: columns, units, rows, frames, gaps, and what looks wrong. Sends nothing."""
    if draft is not None:
        emit(_save_draft(file, draft, robot), as_json, _show_draft)
        return
    check_numpy()
    if preset not in PRESETS:
        raise UsageError(f"--preset {preset}: is not one of {', '.join(PRESETS)}.")
    if rate is not None and not rate > 0:
        raise UsageError(f"--rate {rate}: give frames per second, above 0.")
    order = arguments.split_names([joint_order or ""])
    log = LogHints(topic, order, calibration=calibration, norm_mode=norm_mode, zero=zero)
    document = look(
        file,
        rate_hz=rate,
        allow_cut=allow_cut,
        preset=preset,
        euler=euler,
        unit=unit,
        log=log,
        robot=fetch_joint_names(robot),
    )
    emit(document, as_json, _show)
    if document["problems"]:
        raise typer.Exit(1)


def _save_draft(file: Path, target: Path, robot: str | None) -> dict[str, Any]:
    """Write the draft, never over a file that is there."""
    found = draft(file, fetch_joint_names(robot))
    found.save(target)
    return {"file": str(file), "draft": str(target)} | found.to_document()


def _show_draft(document: dict[str, Any]) -> None:
    print_line(f"{document['draft']}: a column map for {document['file']}")
    for text in document["guessed"]:
        print_line(f"  check {text}")
    for text in document["open"]:
        print_line(f"  fill in {text}")
    if document["unused"]:
        print_line(f"  not used: {', '.join(document['unused'])}")
    print_line(f"Then: kilter upload ROBOT {quote(document['file'])} --map {quote(document['draft'])} --dry-run")


def check_numpy() -> None:
    """Refuse to go on without the packages that files of devices need.

    Raises:
        MissingPackageError: numpy is not installed.

    """
    need("Files of devices need", "numpy")


def _show(document: dict[str, Any]) -> None:
    size = document.get("frames", document.get("rows"))
    what = "frames" if "frames" in document else "rows"
    print_line(f"{document['file']}: {document['kind']}" + (f", {size} {what}" if size is not None else ""))
    if document.get("rate_hz"):
        print_line(f"  {document['rate_hz']:g} Hz, {document['duration_s']:.3f} s")
    for text in document["notes"]:
        print_line(f"  {text}")
    _show_markers(document)
    _show_columns(document)
    for text in document["warnings"]:
        print_line(f"  Warning: {text}.")
    for problem in document["problems"]:
        place = ", ".join(f"{key} {value}" for key, value in problem.items() if key != "what")
        print_line(f"  Problem: {place + ': ' if place else ''}{problem['what']}.")


def _show_markers(document: dict[str, Any]) -> None:
    markers = document.get("markers", [])
    rows = []
    for marker in markers[:MARKERS_SHOWN]:
        noise = "" if marker["noise_mm"] is None else f"{marker['noise_mm']:.4f}"
        span = (
            ""
            if marker["low_mm"] is None
            else "  ".join(
                f"{low:.1f}..{high:.1f}" for low, high in zip(marker["low_mm"], marker["high_mm"], strict=True)
            )
        )
        rows.append((marker["name"], f"{100 * marker['seen']:.1f} %", str(marker["longest_gap_frames"]), noise, span))
    if rows:
        show_rows(("marker", "seen", "longest gap", "noise mm", "x, y, z mm"), rows)
    if len(markers) > MARKERS_SHOWN:
        print_line(f"  and {len(markers) - MARKERS_SHOWN} more markers (--json lists them)")


def _show_columns(document: dict[str, Any]) -> None:
    rows = [
        (c["name"], c.get("unit") or "", *("" if c.get(k) is None else f"{c[k]:.6g}" for k in ("low", "high", "empty")))
        for c in document.get("columns", [])
    ]
    if rows:
        show_rows(("column", "unit", "lowest", "highest", "empty"), rows)
    for topic in document.get("topics", []):
        print_line(f"  {topic['name']}: {topic['messages']} messages of {topic['type']}")
    for channel in document.get("channels", []):
        rate = "" if channel["rate_hz"] is None else f", {channel['rate_hz']:g} Hz"
        span = f", {channel['low']:.6g} to {channel['high']:.6g}" if "low" in channel else ""
        scaled = ", scaled" if channel["scaled"] else ""
        print_line(f"  {channel['name']}: {channel['samples']} samples{rate}{span} {channel['unit']}{scaled}".rstrip())
    for variable in document.get("variables", []):
        print_line(f"  {variable['name']}: {' x '.join(map(str, variable['shape']))}")
