"""``kilter identify | gap | evaluate | plan``: ask for a job and show its result."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli import arguments
from kilter_client.cli.arguments import CampaignIds, Json, MoreOptions, NoWait, Robot, ValidationText
from kilter_client.cli.output import emit, note
from kilter_client.cli.progress import job_bar
from kilter_client.cli.results import show_job
from kilter_client.errors import UsageError

Frame = Literal["free", "fixed"]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter identify ur10 --campaign cmp_1f --validation 0.3 --level 2")(identify)
    app.command(epilog="Example: kilter gap ur10 --campaign cmp_1f --validation cmp_2a --alpha 0.01")(gap)
    app.command(epilog="Example: kilter evaluate ur10 --campaign cmp_2a --version ver_7c --refit base,tool")(evaluate)
    app.command(epilog="Example: kilter plan ur10 --purpose iso9283 --count 118")(plan)


def identify(
    robot: Robot,
    campaign: CampaignIds = None,
    validation: ValidationText = None,
    level: Annotated[int | None, typer.Option(min=1, max=3, help="1 offsets, 2 geometry, 3 with effects.")] = None,
    method: Annotated[str | None, typer.Option(help="Estimator; the server's default is least_squares.")] = None,
    effects: Annotated[
        list[str] | None,
        typer.Option("--effects", "--effect", metavar="A,B", help="Effects to identify, by id (or one as JSON)."),
    ] = None,
    free: Annotated[
        list[str] | None, typer.Option(metavar="A,B", help="Only these parameters (alpha_* works).")
    ] = None,
    fix: Annotated[list[str] | None, typer.Option(metavar="A,B", help="Hold these parameters.")] = None,
    base: Annotated[Frame | None, typer.Option(help="Frame of the measuring device.")] = None,
    tool: Annotated[Frame | None, typer.Option(help="Tool point.")] = None,
    loss: Annotated[Literal["linear", "huber"] | None, typer.Option(help="huber forgives outliers.")] = None,
    tilt_first: Annotated[bool, typer.Option("--tilt-first", help="Hold the starting version's effects.")] = False,
    noise_mm: Annotated[float | None, typer.Option(help="Noise of a coordinate, when it is known.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the split.")] = None,
    start: Annotated[str | None, typer.Option(metavar="VERSION", help="Version to start from.")] = None,
    option: MoreOptions = None,
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Identify a robot's parameters from campaigns; the result is a new version."""
    chosen = arguments.options(
        option,
        level=level,
        method=method,
        effects=arguments.effects(effects),
        free=arguments.split_names(free),
        fix=arguments.split_names(fix),
        base=base,
        tool=tool,
        loss=loss,
        tilt_first=tilt_first,
        noise_mm=noise_mm,
        seed=seed,
        start=start,
    )
    _run("identify", robot, campaign, validation, chosen, no_wait, as_json)


def gap(
    robot: Robot,
    campaign: CampaignIds = None,
    validation: ValidationText = None,
    start: Annotated[str | None, typer.Option(metavar="VERSION", help="Version to start from.")] = None,
    alpha: Annotated[float | None, typer.Option(help="Rate of false alarms.")] = None,
    option: MoreOptions = None,
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Find and name what the model is missing."""
    _run("gap", robot, campaign, validation, arguments.options(option, start=start, alpha=alpha), no_wait, as_json)


def evaluate(
    robot: Robot,
    campaign: CampaignIds = None,
    version: Annotated[str | None, typer.Option(help="Version to evaluate; default is the active one.")] = None,
    refit: Annotated[str | None, typer.Option(metavar="base,tool", help="Frames that were set up anew.")] = None,
    option: MoreOptions = None,
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Compare a version with a campaign."""
    chosen = arguments.options(option, version=version)
    if refit is not None:
        chosen["refit"] = arguments.split_names([refit])
    _run("evaluate", robot, campaign, None, chosen, no_wait, as_json)


def plan(
    robot: Robot,
    campaign: CampaignIds = None,
    purpose: Annotated[str | None, typer.Option(help="iso9283, identify or separate.")] = None,
    count: Annotated[int | None, typer.Option(min=1, help="Number of poses.")] = None,
    effects: Annotated[
        list[str] | None, typer.Option("--effects", "--effect", metavar="A,B", help="Effects to see, or to separate.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the choice.")] = None,
    option: MoreOptions = None,
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Plan poses to measure."""
    chosen = arguments.options(option, purpose=purpose, count=count, effects=arguments.effects(effects), seed=seed)
    _run("plan", robot, campaign, None, chosen, no_wait, as_json, needs_campaign=False)


def _run(
    kind: str,
    robot: str,
    campaign: list[str] | None,
    validation: list[str] | None,
    options: dict[str, Any],
    no_wait: bool,
    as_json: bool,
    needs_campaign: bool = True,
) -> None:
    ids = arguments.split_names(campaign)
    if needs_campaign and not ids:
        raise UsageError(f"Name at least one --campaign ID: `kilter campaigns {robot}` lists them.")
    held_out = arguments.validation(validation)
    with Kilter() as kilter:
        job = kilter.jobs.submit(kind, robot, ids, held_out, options)
        if not no_wait:
            note(f"job {job['id']}", as_json)
            with job_bar(kind, as_json) as progress:
                job = kilter.jobs.wait(job["id"], progress)
    emit(job, as_json, show_job)
