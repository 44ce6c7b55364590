"""The ``kilter`` command: 0 done, 1 the request or the job failed, 2 wrong usage, 130 interrupted."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from kilter_client.cli.groups import FirstLevel, find_new_spelling, join_version_words
from kilter_client.cli.quick_start import with_quick_values, without_httpx_command
from kilter_client.cli.terminal.output import begin_command, name_ids, note, report_error, report_usage
from kilter_client.cli.terminal.references import CODE, UNKNOWN, InterruptedCommandError
from kilter_client.errors import KilterError, UsageError

CALLED_ALIKE = ("reference_ambiguous", "retired")  # errors about what may be called as something else is

app = typer.Typer(
    name="kilter",
    help="Work with a Kilter server: describe robots, upload measurements, identify, and correct.\n\n"
    "First time: robot add, upload, gap, activate, correct, check. To see it work on a simulated arm: kilter demo.\n\n"
    "The server is the one of KILTER_URL, else the one running on this machine. "
    "Every command takes --json: one JSON document on stdout and nothing else. "
    "`kilter COMMAND --help` shows its options and an example.",
    epilog="Example: kilter upload ur10 measured.csv",
    cls=FirstLevel,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def show_version_or_help(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version of this command, and of the server if it answers.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="With --version: as one JSON document.")] = False,
) -> None:
    """Show the version, or the help where no command is given."""
    if version:
        from kilter_client.cli.quick_start import show_releases

        show_releases(as_json)
        raise typer.Exit
    if context.invoked_subcommand is None:
        if as_json:
            raise UsageError("Give a command: `kilter --help` lists them.")
        typer.echo(context.get_help())
        raise typer.Exit(2)
    if as_json:
        name = context.invoked_subcommand
        raise UsageError(f"--json belongs after the command: `kilter {name} ... --json`.")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = run(given)
    except KeyboardInterrupt:  # while an answer or a refusal was being printed
        code = CODE
    sys.exit(code)


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code."""
    as_json = "--json" in arguments
    begin_command()
    arguments = join_version_words(arguments)
    if moved := find_new_spelling(arguments):
        note(f"`kilter {arguments[0]}` is now `kilter {moved}`; the old spelling goes with the next release.", as_json)
    without_httpx_command()
    with_quick_values()
    try:
        code = app(args=list(arguments), prog_name="kilter", standalone_mode=False)
    except UsageError as error:
        report_error(error, as_json)
        return 2
    except InterruptedCommandError as error:
        report_error(error, as_json)
        return CODE
    except KilterError as error:
        from kilter_client.cli.terminal.references import rephrase_error

        error = rephrase_error(error, arguments)
        if not as_json:
            error.detail = name_ids(error.detail, versions_only=error.code in CALLED_ALIKE)
        report_error(error, as_json)
        return 1
    except typer.TyperException as error:
        report_usage(error, as_json)
        return error.exit_code
    except typer.Abort:
        return 1
    if code == CODE:  # typer's word for Ctrl-C where no command knew better
        report_error(InterruptedCommandError(UNKNOWN), as_json)
    return code if isinstance(code, int) else 0
