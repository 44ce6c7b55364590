"""``kilter version accept``: whether an arm keeps a tolerance."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.terminal.arguments import Json, Robot
from kilter_client.cli.terminal.output import emit, number, print_line, show_rows
from kilter_client.cli.terminal.references import resolve_reference
from kilter_client.requests.calls import robots as calls

CODES = {"accepted": 0, "rejected": 3, "not_proved": 4}


class Refit(StrEnum):
    """Frames to fit to the rows."""

    none = "none"
    base = "base"
    both = "base,tool"


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter version accept ur10 --tolerance 0.3")(accept)


def accept(
    robot: Robot,
    tolerance: Annotated[float, typer.Option(help="Tolerance of the place of the tool, mm.", show_default=False)],
    version: Annotated[str | None, typer.Option(metavar="ID", help="The version; else the active one.")] = None,
    campaign: Annotated[
        list[str] | None, typer.Option(metavar="ID", help="Rows of these only; else those of today's number, or all.")
    ] = None,
    refit: Annotated[Refit | None, typer.Option(help="Frames to fit to the rows; else as today's number does.")] = None,
    instrument: Annotated[
        str | None, typer.Option(metavar="NAME", help="What campaigns were measured with that do not say so.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Decide by ISO 14253-1 whether an arm keeps a tolerance, on rows that no fit used.

    Exit code 0: accepted; 3: rejected; 4: neither can be proved.
    """
    with Kilter() as kilter:
        wanted = {
            "tolerance_mm": tolerance,
            "version": None if version is None else resolve_reference(kilter, "version", version, robot, as_json),
            "campaign": [resolve_reference(kilter, "campaign", one, robot, as_json) for one in campaign or ()] or None,
            "refit": None if refit is None else refit.value,
            "instrument": instrument,
        }
        found = kilter.run(calls.accept(robot, wanted))
    emit(found, as_json, _show)
    raise typer.Exit(CODES[found["decision"]])


def _show(found: dict[str, Any]) -> None:
    print_line(found["sentence"])
    rows = [
        (
            one["name"],
            str(one["rows"]),
            number(one["before"]["max_mm"], 3),
            number(one["after"]["max_mm"], 3),
            number(one["error_mm"], 3),
            number(one["guard_band_mm"], 3),
            "none" if found["lacking"] else number(one["provable_mm"], 3),
            one["instrument"] or "none",
        )
        for one in found["campaigns"]
    ]
    head = ("campaign", "rows", "before mm", "after mm", "decides mm", "guard band mm", "proves mm", "instrument")
    show_rows(head, rows, numbers=True)
    for source in found["campaigns"][0]["budget"]["contributions"]:
        if source["of_measured"]:
            print_line(f"  {source['source']}: {number(source['standard_mm'], 3)} mm (type {source['type']})")
    for remark in (*found["lacking"][1:], *found["warnings"]):
        print_line(f"warning: {remark['message']}")
    print_line(f"version {found['version_id']} (sha256 {found['version_sha256'][:12]})")
