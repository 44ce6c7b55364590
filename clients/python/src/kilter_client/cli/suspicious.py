"""``kilter measure suspicious``: the rows of a campaign that look wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, number, print_line, show_list
from kilter_client.cli.terminal.references import OfRobot, resolve_reference

CampaignId = Annotated[str, typer.Argument(help="Campaign: id, name or `latest`.", show_default=False)]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure suspicious cmp_1f")(suspicious)


def suspicious(campaign: CampaignId, robot: OfRobot = None, as_json: Json = False) -> None:
    """Name the rows of a campaign that look wrong, and who says so: the rows themselves, or a version's job."""
    with Kilter() as kilter:
        campaign = resolve_reference(kilter, "campaign", campaign, robot, as_json)
        emit(kilter.campaigns.suspicious(campaign), as_json, show_suspicious)


def show_suspicious(document: Mapping[str, Any]) -> None:
    """Print how many rows look wrong, and a line for each and everybody who says so."""
    print_line(f"{document['name']}: {document['sentence']}")
    rows = [
        (
            _place(one),
            number(one["mm"]),
            number(one["sigma"], 3),
            "the rows themselves" if one["said_by"] == "rows" else f"{one['said_by']} {one['version_id']}",
            one["why"],
        )
        for one in document["found"]
    ]
    if rows:
        show_list(("row", "off by mm", "sigma", "says who", "why"), rows)


def _place(one: Mapping[str, Any]) -> str:
    return str(one["row"]) if one["file"] == 1 else f"{one['row']} (row {one['file_row']} of file {one['file']})"
