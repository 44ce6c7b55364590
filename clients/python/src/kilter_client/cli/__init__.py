"""The ``kilter`` command: 0 done, 1 the request or the job failed, 2 wrong usage."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer

from kilter_client.cli import (
    analyse,
    campaigns,
    correct,
    inspect,
    jobs,
    joins,
    joints,
    match,
    residuals,
    robots,
    sheet,
    versions,
)
from kilter_client.cli.output import report_error, report_interrupt, report_usage
from kilter_client.errors import KilterError, UsageError

app = typer.Typer(
    name="kilter",
    help="Work with a Kilter server: describe robots, upload measurements, identify, and correct.\n\n"
    "The server is the one of KILTER_URL, else the one running on this machine. "
    "Every command takes --json: one JSON document on stdout and nothing else.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for module in (robots, inspect, campaigns, match, sheet, joins, analyse, joints, jobs, versions, residuals, correct):
    module.register(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    sys.exit(run(given))


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code."""
    as_json = "--json" in arguments
    try:
        code = app(args=list(arguments), prog_name="kilter", standalone_mode=False)
    except UsageError as error:
        report_error(error, as_json)
        return 2
    except KilterError as error:
        report_error(error, as_json)
        return 1
    except typer.TyperException as error:
        report_usage(error, as_json)
        return error.exit_code
    except typer.Abort:
        return 1
    if code == 130:
        report_interrupt(as_json)
        return 1
    return code if isinstance(code, int) else 0
