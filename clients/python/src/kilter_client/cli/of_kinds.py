"""A command for each kind of job that has none written for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client.cli.analyse import needs_result, run_job
from kilter_client.cli.catalogue import KINDS_BY_COMMAND, MOVED
from kilter_client.cli.stored.versions import write
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
from kilter_client.cli.terminal.output import note
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
        output: Annotated[
            Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write its rows as CSV.", dir_okay=False)
        ] = None,
        as_json: Json = False,
    ) -> None:
        needs_result(no_wait, output=output)

        def files(job: dict[str, Any]) -> None:
            text = (job.get("result") or {}).get("csv")
            if output is not None and text:
                write(output, text.encode())
            if output is not None:
                note(
                    f"{output}: {text.count(chr(10)) - 1} rows" if text else f"{output}: not written: no rows.", as_json
                )

        chosen, needed = arguments.options(option), KINDS[kind].needs_campaigns
        run_job(
            kind, robot, campaign, validation, chosen, no_wait, as_json, needed, name=name, check=check, files=files
        )

    return with_flags(kind)(command)
