"""``kilter homing``: the zero offsets of a version as homing offsets of servos, in a copy of LeRobot's calibration."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli import exported
from kilter_client.cli.arguments import Json, VersionId
from kilter_client.cli.files.inspect import check_numpy
from kilter_client.cli.output import emit, say
from kilter_client.cli.references import OfRobot, resolved
from kilter_client.cli.tables import show_rows
from kilter_client.cli.versions import write
from kilter_client.errors import UsageError

WRITE = (
    "Start the arm with the copy and let LeRobot write it into the servos. It is another calibration: what is measured with "
    "it belongs to a robot of its own."
)


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter homing my_arm.json ver_7c -o trued.json --servos feetech --norm-mode DEGREES")(
        homing
    )


def homing(
    calibration: Annotated[
        Path,
        typer.Argument(
            help="The calibration with which the arm was measured.", metavar="JSON", exists=True, dir_okay=False,
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
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Put a version's zero offsets into a copy of LeRobot's calibration, to the tick, and show what changes."""
    check_numpy()
    from kilter_files.formats.lerobot.calibration import read_calibration
    from kilter_files.formats.lerobot.homing import with_zero_offsets

    if output.resolve() == calibration.resolve():
        raise UsageError(f"{output} is the calibration itself, which stays as it is: name another file.")
    found = read_calibration(calibration)
    with Kilter() as kilter:
        version = resolved(kilter, "version", version, robot, as_json)
        told = exported.lists_of_export(kilter.versions.export(version, "mdh-csv"))
    offsets = {one["joint"]: one["offset_deg"] for one in told["zero_offsets"]}
    text, changes = with_zero_offsets(found, offsets, norm_mode, servos)
    write(output, text.encode())
    before = calibration.read_text(encoding="utf-8").splitlines()
    diff = list(difflib.unified_diff(before, text.splitlines(), str(calibration), str(output), lineterm="", n=0))
    document = {"version_id": version, "output": str(output), "servos": [vars(one) for one in changes], "diff": diff}
    emit(document, as_json, _show)


def _show(document: Mapping[str, Any]) -> None:
    rows = [
        (
            one["servo"],
            str(one["before"]),
            str(one["after"]),
            f"{one['after'] - one['before']:+d}",
            f"{one['left_deg']:+.4f}",
        )
        for one in document["servos"]
    ]
    show_rows(("servo", "homing offset", "now", "ticks", "left deg"), rows, numbers=True)
    for line in document["diff"]:
        say(line)
    say(WRITE)
