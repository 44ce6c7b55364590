"""``kilter measure campaigns``."""

from __future__ import annotations

from typing import Any

import typer

from kilter_client import Kilter
from kilter_client.cli.stored import keeping
from kilter_client.cli.terminal.arguments import Json, Retired, Robot
from kilter_client.cli.terminal.output import emit, show_list

group = typer.Typer(
    help="List, name, retire and purge campaigns; without a command, list those of a robot.",
    rich_markup_mode=None,
    no_args_is_help=True,
    cls=keeping.ListsByDefault,
)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    keeping.register(group, "campaign")
    app.add_typer(group, name="campaigns")


@group.command("list", epilog="Example: kilter measure campaigns list ur10")
def list_(robot: Robot, retired: Retired = False, as_json: Json = False) -> None:
    """List the campaigns of a robot."""
    with Kilter() as kilter:
        document = {"campaigns": kilter.campaigns.list(robot, retired=retired)}
    emit(document, as_json, _show_campaigns)


def _show_campaigns(document: dict[str, Any]) -> None:
    rows = [
        (
            (c["name"] or c["id"]) + (" (retired)" if c.get("retired_at") else ""),
            c["device"],
            c["role"],
            str(c["rows"]),
            str(c["created_at"])[:16].replace("T", " "),
        )
        for c in document["campaigns"]
    ]
    show_list(("campaign", "device", "role", "rows", "made"), rows, newest_last=True)
