"""``kilter check | drift | rezero``: say by a few poses whether the arm has moved, and make a version of what did."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.analyse import run_job
from kilter_client.cli.files.upload import Device, InstrumentName, MeasuredAt, build_conditions, sent_file
from kilter_client.cli.reports.answer import suggest_after_job
from kilter_client.cli.reports.results import EXIT_CODES, show_history, show_job, show_robots
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import (
    ColumnMap,
    Details,
    JobName,
    Json,
    MoreOptions,
    NoWait,
    PayloadCentre,
    Robot,
    with_flags,
)
from kilter_client.cli.terminal.output import emit, job_bar, note, print_line
from kilter_client.cli.terminal.references import (
    job_goes_on,
    job_name,
    on_interrupt,
    resolve_reference,
    resolved_options,
)
from kilter_client.errors import UsageError
from kilter_client.requests.calls import robots as calls
from kilter_client.typed.option_texts import REZERO
from kilter_client.verbs.inputs import parse_time

Rows = Annotated[
    Path | None,
    typer.Argument(
        help="Poses that were measured again, three or more.",
        metavar="FILE",
        exists=True,
        dir_okay=False,
        show_default=False,
    ),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter check ur10 today.csv --temperature-c 23.5")(check)
    app.command(epilog="Example: kilter watch drift ur10")(drift)
    app.command(epilog='Example: kilter watch repair ur10 "gear of joint 3 replaced" --at 2026-11-18T14:30')(repair)
    app.command(epilog="Example: kilter watch rezero ur10 --campaign today.csv --cause zero_1")(rezero)


@with_flags("drift")
def check(
    robot: Robot,
    file: Rows = None,
    campaign: Annotated[
        str | None,
        typer.Option("--campaign", "-c", metavar="ID", help="Check with a campaign that is stored already."),
    ] = None,
    device: Device = None,
    column_map: ColumnMap = None,
    payload_kg: Annotated[float | None, typer.Option(help="Mass at the tool point, kg.")] = None,
    payload_com_mm: PayloadCentre = None,
    temperature_c: Annotated[float | None, typer.Option(help="Temperature of the arm, deg C.")] = None,
    measured_at: MeasuredAt = None,
    instrument: InstrumentName = None,
    option: MoreOptions = None,
    name: Annotated[str, typer.Option(help="Name of the campaign and of the job.")] = "",
    no_wait: NoWait = False,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Say whether an arm has moved since its version was made: exit code 0 ok, 3 moved, 4 cannot tell.

    The rows become a campaign with the role validation, which no fit takes unless it names it.
    """
    if (file is None) == (campaign is None):
        raise UsageError("Give the FILE that was measured, or --campaign ID of one that is stored.")
    chosen = arguments.options(option)
    conditions = build_conditions(payload_kg, payload_com_mm, temperature_c)
    if campaign is not None and (conditions or device or column_map or measured_at or instrument):
        raise UsageError("--campaign checks with rows that have their device, instrument, conditions and date already.")
    with Kilter() as kilter:
        chosen = resolved_options(kilter, chosen, robot, as_json)
        if file is None:
            used = resolve_reference(kilter, "campaign", str(campaign), robot, as_json, "--campaign")
        else:
            done = sent_file(
                robot, file, device, column_map, "validation", conditions, name, measured_at, instrument, as_json
            )
            used = str(done["campaign_id"])
        job = kilter.jobs.submit("drift", robot, [used], None, chosen, [], name)
        if not no_wait:
            with on_interrupt(partial(job_goes_on, job)), job_bar("check", as_json) as progress:
                note(f"job: {job_name(job)}", as_json)
                job = dict(kilter.jobs.wait(job["id"], progress))
        suggested = [] if as_json else suggest_after_job(kilter, job)
    emit(job, as_json, partial(show_job, details=details, head=False, suggested=suggested, server=kilter.url))
    code = EXIT_CODES.get(_verdict(job), 0)
    if code:
        raise typer.Exit(code)


def drift(
    robot: Annotated[
        str | None, typer.Argument(help="Name of the robot; left out: all, the worst first.", metavar="ROBOT")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show the checks of a robot and what creeps, or how all robots stand, the worst first."""
    with Kilter() as kilter:
        if robot is None:
            emit(kilter.robots.drifts(), as_json, show_robots)
        else:
            emit(kilter.robots.drift(robot), as_json, show_history)


def repair(
    robot: Robot,
    what: Annotated[
        str | None, typer.Argument(help="What was done: gear of joint 3 replaced.", metavar="WHAT", show_default=False)
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="WHEN", help="When: 2026-11-18 (noon), or 2026-11-18T14:30; left out: now."),
    ] = None,
    remove: Annotated[
        str | None, typer.Option(metavar="ID", help="Take a repair back; `kilter watch drift ROBOT` lists their ids.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Record what was done to an arm: its checks, charts and comparisons begin anew with it.

    Rows measured before are of the arm as it was: no chart, acceptance or guard of an activation counts them.
    """
    if (what is None) == (remove is None):
        raise UsageError('Say WHAT was done, as "gear of joint 3 replaced", or --remove ID to take a repair back.')
    with Kilter() as kilter:
        if remove is not None:
            kilter.run(calls.remove_repair(robot, remove))
            emit({"removed": remove}, as_json, lambda one: print_line(f"Repair {one['removed']} is removed."))
        else:
            emit(kilter.run(calls.add_repair(robot, str(what), parse_time(at))), as_json, _show_repair)


def _show_repair(one: dict[str, Any]) -> None:
    print_line(f"Repair {one['id']}, {str(one['at'])[:16].replace('T', ' ')} UTC: {one['what']}.")
    print_line(
        "Checks and charts begin anew with it. Check the arm (kilter check), and take a mistake back with --remove."
    )


@with_flags("rezero", seldom=("causes", "limits"))
def rezero(
    robot: Robot,
    campaign: Annotated[
        str,
        typer.Option(
            "--campaign", "-c", metavar="ID", help="Campaign of the check: id or its beginning, name, `latest`."
        ),
    ] = "latest",
    cause: Annotated[list[str] | None, typer.Option("--cause", metavar="A,B", help=REZERO["causes"])] = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Make a version of the one or few parameters that moved; everything else stays as it was identified."""
    chosen = arguments.options(option, causes=arguments.split_names(cause))
    run_job("rezero", robot, [campaign], None, chosen, no_wait, as_json, name=name, details=details)


def _verdict(job: dict[str, Any]) -> str:
    return str((job.get("result") or {}).get("verdict"))
