"""A command for each kind of job that has none written for it."""

from __future__ import annotations

from collections.abc import Callable

import typer

from kilter_client.cli.analyse import run_job
from kilter_client.cli.catalogue import KINDS_BY_COMMAND, MOVED
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import (
    CampaignIds,
    Check,
    JobName,
    Json,
    MoreOptions,
    NoWait,
    Robot,
    ValidationText,
    with_flags,
)
from kilter_client.typed.option_texts import KINDS


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    for name, kind in KINDS_BY_COMMAND.items():
        example = (
            f"Example: kilter {MOVED.get(name, name)} ur10{' --campaign cmp_1f' if KINDS[kind].needs_campaigns else ''}"
        )
        app.command(name, help=KINDS[kind].summary, epilog=example)(_make_command(kind))


def _make_command(kind: str) -> Callable[..., None]:
    def command(
        robot: Robot,
        campaign: CampaignIds = None,
        validation: ValidationText = None,
        option: MoreOptions = None,
        name: JobName = "",
        no_wait: NoWait = False,
        check: Check = False,
        as_json: Json = False,
    ) -> None:
        chosen, needed = arguments.options(option), KINDS[kind].needs_campaigns
        run_job(kind, robot, campaign, validation, chosen, no_wait, as_json, needed, name=name, check=check)

    return with_flags(kind)(command)
