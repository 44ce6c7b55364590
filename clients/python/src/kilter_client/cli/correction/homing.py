"""``kilter robot homing``: the zero offsets of a version as homing offsets of servos, in a copy of LeRobot's calibration."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.files.inspect import check_numpy
from kilter_client.cli.stored import versions
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import Json, VersionId
from kilter_client.cli.terminal.output import emit, print_line, show_rows
from kilter_client.cli.terminal.references import OfRobot, resolve_reference
from kilter_client.errors import ConflictError, NotFoundError, UsageError
from kilter_client.files import files_formats, files_rig, files_robots
from kilter_client.verbs.servo_calibration import CONDITION

if TYPE_CHECKING:
    from kilter_files.formats import Calibration, Homed

WRITE = (
    "Start the arm with the copy and let LeRobot write it into the servos. It is another calibration: what is measured with "
    "it belongs to a robot of its own."
)

NOT_COMPARED = (
    "No campaign of this version states with which calibration it was measured (kilter upload --calibration), so nobody "
    "compared it with this one: make sure that it is the same."
)

_NOTHING = (
    "Version {version} tells no zero by a tick or more ({states}): the homing offsets stay as they are. Measure the arm with "
    "more poses or with points in its own base, or write what is uncertain too with --uncertain."
)


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(
        epilog="Example: kilter robot homing my_arm.json so101 v2 -o trued.json --servos feetech --norm-mode DEGREES"
    )(homing)


def homing(
    calibration: Annotated[
        Path,
        typer.Argument(
            help="The calibration with which the arm was measured.",
            metavar="JSON",
            exists=True,
            dir_okay=False,
            show_default=False,
        ),
    ],
    version: VersionId,
    output: Annotated[Path, typer.Option("--output", "-o", help="The copy to write.")],
    servos: Annotated[
        Literal["feetech", "dynamixel"],
        typer.Option(help="Whose servos: SO-100, SO-101 and LeKiwi have Feetech's, Koch's Dynamixel's."),
    ],
    norm_mode: Annotated[
        Literal["RANGE_M100_100", "DEGREES"],
        typer.Option("--norm-mode", help="In which norm mode the arm was measured."),
    ],
    uncertain: Annotated[
        bool, typer.Option("--uncertain", help="Write zeros too that the version does not tell apart from 0.")
    ] = False,
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:
    """Put a version's zero offsets into a copy of LeRobot's calibration, to the tick, and show what changes.

    Only zeros that the version tells are written: those whose 95 % interval leaves 0 out.
    """
    check_numpy()
    if output.resolve() == calibration.resolve():
        raise UsageError(f"{output} is the calibration itself, which stays as it is: name another file.")
    found = files_formats.of_follower(calibration)
    with Kilter() as kilter:
        version = resolve_reference(kilter, "version", version, robot, as_json)
        stated = _refuse_other(kilter, version, found)
        told = files_robots.lists_of_export(kilter.versions.export(version, "mdh-csv"))
    zeros = told.get("zero_offsets", [])
    offsets = _to_write(zeros, uncertain)
    text, changes = files_formats.with_zero_offsets(found, offsets, norm_mode, servos)
    if all(one.before == one.after for one in changes):
        raise UsageError(_NOTHING.format(version=version, states=", ".join(_state(one) for one in zeros)))
    write(output, text.encode())
    before = calibration.read_text(encoding="utf-8").splitlines()
    diff = list(difflib.unified_diff(before, text.splitlines(), str(calibration), str(output), lineterm="", n=0))
    document = {
        "version_id": version,
        "output": str(output),
        "servos": _rows(changes, zeros),
        "diff": diff,
        "calibration_compared": stated,
    }
    emit(document, as_json, _show)


def _refuse_other(kilter: Kilter, version: str, calibration: Calibration) -> bool:
    """Compare the calibration with that of the version's campaigns; False where none states one."""
    compared = False
    for campaign in kilter.versions.get(version)["campaigns"]:
        try:
            measured = kilter.campaigns.get(str(campaign["id"]))
        except NotFoundError:  # purged since
            continue
        has = measured["conditions"].get(CONDITION)
        if has not in (None, calibration.sha256):
            raise ConflictError(
                f"{calibration.path}: its SHA-256 is {calibration.sha256[:12]}, campaign {measured['name']!r} of version "
                f"{version} was measured with {has[:12]}: with other zeros it is another arm. Give the calibration with which "
                "it was measured.",
                code="calibration_differs",
            )
        compared = compared or has is not None
    return compared


def _to_write(zeros: Sequence[Mapping[str, Any]], uncertain: bool) -> dict[str, float]:
    """Offset of each joint in degrees, 0 where the servo keeps its own."""
    if not zeros:
        raise UsageError("This version's table has no zero offsets: its robot has no joints with a zero.")
    if slides := [one["joint"] for one in zeros if "offset_deg" not in one]:
        raise UsageError(
            f"Joint {slides[0]} slides: a homing offset is an angle of a servo. Name a version of a servo arm."
        )
    states = {"known", "uncertain", "unstated"} if uncertain else {"known"}
    return {one["joint"]: one["offset_deg"] if one["state"] in states else 0.0 for one in zeros}


def _rows(changes: Sequence[Homed], zeros: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Each servo: its homing offset before and after, and the zero offset with its interval, whether written or not."""
    rows = []
    for change, one in zip(changes, zeros, strict=True):
        half = one["half_width_deg"]
        rows.append(
            {
                **vars(change),
                "offset_deg": one["offset_deg"],
                "half_width_deg": half,
                "half_width_ticks": None if half is None else half / files_rig.TICK_DEG,
                "state": one["state"],
            }
        )
    return rows


def _state(one: Mapping[str, Any]) -> str:
    return f"{one['joint']} {versions.STATES[one['state']]}"


def _format_half_width(half_ticks: float) -> str:
    """Half the width of an interval, which is never nothing."""
    return f"±{half_ticks:.0f}" if half_ticks >= 1.0 else f"±{max(half_ticks, 0.1):.1f}"


def _show(document: Mapping[str, Any]) -> None:
    rows = []
    for one in document["servos"]:
        half = (
            "–"
            if one["half_width_ticks"] is None or one["state"] == "held"
            else _format_half_width(one["half_width_ticks"])
        )
        rows.append(
            (
                one["servo"],
                str(one["before"]),
                str(one["after"]),
                f"{one['after'] - one['before']:+d}",
                half,
                f"{one['left_deg']:+.4f}",
                versions.STATES[one["state"]],
            )
        )
    show_rows(("servo", "homing offset", "now", "ticks", "95 %", "left deg", "its zero is"), rows, numbers=True)
    for line in document["diff"]:
        print_line(line)
    if not document["calibration_compared"]:
        print_line(NOT_COMPARED)
    print_line(WRITE)
