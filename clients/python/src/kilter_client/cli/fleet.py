"""``kilter robot fleet``: identify many robots anew, follow it, and show what came out."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.terminal.arguments import Json, MoreOptions, NoWait, effects, options, split_names
from kilter_client.cli.terminal.output import emit, job_bar, note, print_line, show_rows
from kilter_client.cli.terminal.references import fleet_goes_on, on_interrupt
from kilter_client.errors import UsageError

fleet = typer.Typer(help="Identify many robots anew, and show what came out.", rich_markup_mode=None, cls=Group)

FleetId = Annotated[
    str,
    typer.Argument(help="Its id; left out: the newest.", show_default=False, metavar="[FLEET]"),
]
Robots = Annotated[
    list[str] | None,
    typer.Argument(help="Names of the robots; none: all that are in use.", metavar="[ROBOT]...", show_default=False),
]
Campaigns = Annotated[
    list[str] | None,
    typer.Option(
        "--campaign",
        "-c",
        metavar="ROBOT=ID",
        help="Campaign to use for a robot; repeat for more. Left out: those that its active version was made from and "
        "what was measured since.",
        show_default=False,
    ),
]
Fraction = Annotated[
    float | None,
    typer.Option(
        "--validation",
        "-v",
        min=0.0,
        max=1.0,
        metavar="FRACTION",
        help="Fraction of the poses to hold out where no campaign was measured for validation.",
        show_default="0.2",
    ),
]
Level = Annotated[
    int | None,
    typer.Option(min=1, max=3, help="1 joint offsets, 2 geometry, 3 geometry and effects.", show_default=False),
]
Effects = Annotated[
    list[str] | None,
    typer.Option(metavar="ID,...", help="Effects to identify, of all robots.", show_default=False),
]
Name = Annotated[str, typer.Option("--name", help="Name of the fleet job and of the versions that it makes.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.add_typer(fleet, name="fleet")


@fleet.callback(invoke_without_command=True)
def default(context: typer.Context, as_json: Json = False) -> None:
    """Identify many robots anew; without a command, list the fleet jobs."""
    if context.invoked_subcommand is None:
        list_(as_json=as_json)


@fleet.command(epilog="Example: kilter robot fleet identify --name autumn")
def identify(
    robots: Robots = None,
    campaigns: Campaigns = None,
    fraction: Fraction = None,
    level: Level = None,
    chosen: Effects = None,
    more: MoreOptions = None,
    name: Name = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Identify robots anew, each by a job of its own. Without options each as its active version; nothing is activated."""
    asked = options(more, level=level, effects=effects(chosen))
    with Kilter() as kilter:
        queued = kilter.identify_fleet(
            robots or None, campaigns=_by_robot(campaigns), validation=fraction, options=asked or None, name=name
        )
        if no_wait:
            emit(queued, as_json, lambda one: print_line(f"Fleet job {one['id']} is queued: {one['robots']} robots."))
            return
        _follow(kilter, queued["id"], as_json)


@fleet.command("list", epilog="Example: kilter robot fleet list")
def list_(
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many of the newest to show.")] = 100,
    as_json: Json = False,
) -> None:
    """List the fleet jobs, newest first."""
    with Kilter() as kilter:
        emit({"fleet_jobs": kilter.fleet_jobs(limit)}, as_json, _show_list)


@fleet.command(epilog="Example: kilter robot fleet show")
def show(fleet_job: FleetId = "", as_json: Json = False) -> None:
    """Show what became of each robot."""
    with Kilter() as kilter:
        emit(kilter.fleet_job(_id(kilter, fleet_job)), as_json, _show)


@fleet.command(epilog="Example: kilter robot fleet watch flt_0123456789abcdef")
def watch(fleet_job: FleetId = "", as_json: Json = False) -> None:
    """Follow a fleet job to its end and show what became of each robot."""
    with Kilter() as kilter:
        _follow(kilter, _id(kilter, fleet_job), as_json)


@fleet.command(epilog="Example: kilter robot fleet cancel flt_0123456789abcdef")
def cancel(
    fleet_job: Annotated[str, typer.Argument(help="Its id.", show_default=False, metavar="FLEET")],
    as_json: Json = False,
) -> None:
    """Cancel the jobs that are not over; versions that were made stay."""
    with Kilter() as kilter:
        emit(kilter.cancel_fleet(fleet_job), as_json, _show)


def _follow(kilter: Kilter, fleet_id: str, as_json: bool) -> None:
    with on_interrupt(partial(fleet_goes_on, fleet_id)), job_bar(fleet_id, as_json) as progress:
        done = kilter.wait_for_fleet(fleet_id, progress=progress)
    emit(done, as_json, _show)
    if done["counts"]["succeeded"] < done["robots"]:
        raise typer.Exit(1)


def _id(kilter: Kilter, given: str) -> str:
    if given:
        return given
    newest = kilter.fleet_jobs(1)
    if not newest:
        raise UsageError("There is no fleet job yet: `kilter robot fleet identify` makes one.")
    return str(newest[0]["id"])


def _by_robot(texts: list[str] | None) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for text in split_names(texts):
        robot, equals, campaign = text.partition("=")
        if not (robot and equals and campaign):
            raise UsageError(f"--campaign {text}: give ROBOT=ID, for example --campaign ur10=cmp_0123456789abcdef.")
        found.setdefault(robot, []).append(campaign)
    return found


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (one["id"], one["name"], one["state"], one["progress"]["stage"], one["created_at"][:16].replace("T", " "))
        for one in document["fleet_jobs"]
    ]
    show_rows(("fleet job", "name", "state", "done", "made"), rows)


def _show(document: dict[str, Any]) -> None:
    rows = [
        (
            one["robot"],
            one["state"],
            one["version_id"] or "",
            _mm(one["held_out_before_mm"]),
            _mm(one["held_out_after_mm"]),
            _remark(one),
        )
        for one in document["report"]
    ]
    show_rows(("robot", "state", "version", "before, mm", "after, mm", ""), rows)
    counts = ", ".join(f"{number} {state}" for state, number in document["counts"].items() if number)
    note(
        f"{document['id']}: {counts}. Errors are of held-out poses. Nothing was activated (`kilter activate VERSION`)."
    )


def _mm(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _remark(one: dict[str, Any]) -> str:
    """What matters most of a robot: why there is no version, what speaks against it, why it was not compared."""
    said = [one["error"]] if one["error"] else [*one["objections"], *one["warnings"]]
    return str(said[0]["message"]) if said else ""
