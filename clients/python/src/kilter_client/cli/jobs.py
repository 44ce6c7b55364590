"""``kilter server jobs``: list, show, watch, cancel."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.reports.answer import suggest_after_job
from kilter_client.cli.reports.results import show_job
from kilter_client.cli.terminal.arguments import Details, Json
from kilter_client.cli.terminal.output import emit, job_bar, note, show_list
from kilter_client.cli.terminal.references import (
    OfRobot,
    job_goes_on,
    job_name,
    looked_up,
    on_interrupt,
    resolve_reference,
)

jobs = typer.Typer(help="List, show, watch and cancel jobs.", rich_markup_mode=None, cls=Group)

JobId = Annotated[
    str, typer.Argument(help="Its id or the beginning of it, its name, or `latest`.", show_default=False, metavar="JOB")
]
State = Annotated[
    Literal["queued", "running", "succeeded", "failed", "cancelled"] | None,
    typer.Option(help="Only jobs in this state."),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.add_typer(jobs, name="jobs")


@jobs.callback(invoke_without_command=True)
def default(context: typer.Context, as_json: Json = False) -> None:
    """List, show, watch and cancel jobs; without a command, list them."""
    if context.invoked_subcommand is None:
        list_(as_json=as_json)


@jobs.command("list", epilog="Example: kilter server jobs list --state running")
def list_(
    robot: Annotated[str | None, typer.Option(help="Only those of this robot.")] = None,
    state: State = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many of the newest to look at.")] = 100,
    as_json: Json = False,
) -> None:
    """List the jobs, newest first."""
    with Kilter() as kilter:
        document = {"jobs": [job for job in kilter.jobs.list(robot, limit) if state in (None, job["state"])]}
    emit(document, as_json, _show_list)


@jobs.command(epilog="Example: kilter server jobs show job_1f")
def show(job: JobId, robot: OfRobot = None, details: Details = False, as_json: Json = False) -> None:
    """Show a job and its result."""
    with Kilter() as kilter:
        job = resolve_reference(kilter, "job", job, robot, as_json)
        document = kilter.jobs.get(job)
        suggested = [] if as_json else suggest_after_job(kilter, document)
    emit(document, as_json, partial(show_job, details=details, suggested=suggested))


@jobs.command(epilog="Example: kilter server jobs watch job_1f")
def watch(job: JobId, robot: OfRobot = None, details: Details = False, as_json: Json = False) -> None:
    """Follow a job to its end and show its result."""
    with Kilter() as kilter:
        job, sentence = looked_up(kilter, "job", job, robot)
        with on_interrupt(partial(job_goes_on, job)):
            if sentence:
                note(sentence, as_json)
            with job_bar(job, as_json) as progress:
                document = kilter.jobs.wait(job, progress)
        suggested = [] if as_json else suggest_after_job(kilter, document)
    emit(document, as_json, partial(show_job, details=details, suggested=suggested))


@jobs.command(epilog="Example: kilter server jobs cancel job_1f")
def cancel(job: JobId, robot: OfRobot = None, as_json: Json = False) -> None:
    """Ask a job to stop."""
    with Kilter() as kilter:
        job = resolve_reference(kilter, "job", job, robot, as_json)
        emit(kilter.jobs.cancel(job), as_json, show_job)


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (
            job_name(job),
            job["kind"],
            job["robot"],
            job["state"],
            f"{100 * float((job.get('progress') or {}).get('fraction') or 0):.0f} %",
            str(job.get("created_at", ""))[:16].replace("T", " "),
            job.get("asked_by", ""),
        )
        for job in document["jobs"]
    ]
    show_list(("job", "kind", "robot", "state", "done", "made", "by"), rows)
