"""``kilter identify | gap | evaluate``: ask for a job and show its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.reports.answer import suggest_after_job
from kilter_client.cli.reports.results import show_job
from kilter_client.cli.simulator import ModelSearch, search_models
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import (
    CampaignIds,
    Check,
    ConfirmationIds,
    Details,
    HuntValidation,
    JobName,
    Json,
    MoreOptions,
    NoWait,
    Robot,
    ValidationText,
    with_flags,
)
from kilter_client.cli.terminal.output import emit, job_bar, note, number, print_line, show_rows
from kilter_client.cli.terminal.references import job_goes_on, job_name, on_interrupt, resolved_all, resolved_options
from kilter_client.errors import UsageError
from kilter_client.results.plots import can_draw, save_figures
from kilter_client.typed.option_texts import GAP, IDENTIFY

FEW_REASONS = 2  # of one remedy, from which they stand in the JSON alone
MOST_REMEDIES = 6  # of a check on a screen
MOST_TERMS = 4  # of a sum that anybody would read; longer ones stand in the JSON
HOW = {
    "campaigns": "the campaigns named",
    "fraction": "as asked",
    "folds": "every pose once, in folds",
    "unasked": "a quarter, unasked",
}


def finish_check(told: dict[str, Any], as_json: bool, details: bool) -> None:
    """Print a check.

    Raises:
        typer.Exit: the job would fail.

    """
    emit(told, as_json, partial(show_check, details=details))
    if not told["would_run"]:
        raise typer.Exit(1)


def show_check(told: Mapping[str, Any], details: bool = True) -> None:
    """Print a check: what a job would use and find out, and what it would fail of; without ``details`` on one screen."""
    print_line(
        f"{told['kind']} of {told['robot']}: {'would run' if told['would_run'] else 'would fail'}; nothing was queued"
    )
    for problem in told["problems"]:
        print_line(f"  {problem['code']}: {problem['message']}")
    rows = [(c["name"] or c["id"], c["use"], str(c["rows"]), number(c["poses"])) for c in told["campaigns"]]
    if rows:
        show_rows(("campaign", "use", "rows", "poses"), rows)
    held = told["held_out"]
    if held["how"] != "none":
        print_line(f"held out: {held['poses']} poses, {held['rows']} rows ({HOW[held['how']]})")
    _show_identifiability(told.get("identifiability"))
    testability = told.get("testability")
    if testability:
        print_line(f"{len(testability['testable'])} parameters of effects can be tested")
    _show_missing(told["missing"], details)
    for limit in told["limited"]:
        print_line(f"note: {limit}")
    last = told["duration_s"]
    print_line(
        f"it would take some {number(last['expected'])} s ({number(last['low'])} to {number(last['high'])} s): {last['basis']}"
    )


def _show_identifiability(told: Mapping[str, Any] | None) -> None:
    if told:
        print_line(
            f"{told['parameters']} parameters, {len(told['identifiable'])} identifiable, rank {told['rank']}; judged with "
            f"{number(told['noise_mm'])} mm of noise ({told['noise_from']})"
        )
        for one in (one for direction in told["null_directions"] for one in direction.get("sums") or ()):
            if len(one["parameters"]) <= MOST_TERMS:
                print_line(f"  {one['sentence']}")


def _show_missing(missing: Sequence[Mapping[str, Any]], details: bool) -> None:
    """What the data do not tell, with the remedy that would: the same for dozens of parameters is said once."""
    by_remedy: dict[str, dict[str, list[str]]] = {}
    for one in missing:
        by_remedy.setdefault(one["remedy"], {}).setdefault(one["reason"], []).append(one["what"])
    if by_remedy:
        print_line("not determined by these data:")
    if not details:
        for remedy, reasons in list(by_remedy.items())[:MOST_REMEDIES]:
            names = [name for own in reasons.values() for name in own]
            more = f" and {len(names) - FEW_REASONS} more" if len(names) > FEW_REASONS else ""
            print_line(f"  {', '.join(names[:FEW_REASONS])}{more}: {remedy}")
        if (left := len(by_remedy) - MOST_REMEDIES) > 0:
            print_line(f"  and {left} more (--details)")
        return
    for remedy, reasons in by_remedy.items():
        names = [name for own in reasons.values() for name in own]
        if len(reasons) <= FEW_REASONS:
            for reason, own in reasons.items():
                print_line(f"  {', '.join(own)}: {reason}")
        else:
            print_line(f"  {', '.join(names)} ({len(names)} in all)")
        print_line(f"    {remedy}")


AT_JOINTS = ' One at some joints: \'{"id": "backlash", "joints": [2, 3]}\'; `kilter server effects` lists all.'
Refit = Annotated[
    Literal["base", "tool", "base,tool", "none"] | None,
    typer.Option(
        help="base, tool: one for each campaign and session; none: one for all; left out: sheets and bars have their own."
    ),
]
OWN_TOOL = "tool: a tool for each campaign and session; left out: one for all."
Figures = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder for the figures: Plotly JSON; with matplotlib PNG and SVG too.",
        file_okay=False,
    ),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command(epilog="Example: kilter identify ur10 --campaign cmp_1f --validation 0.3 --level 2")(identify)
    app.command(epilog="Example: kilter gap ur10 --campaign cmp_1f --validation 0.25 --figures gap --poses next.csv")(
        gap
    )
    app.command(epilog="Example: kilter version evaluate ur10 --campaign cmp_2a --version ur10 v2 --refit base,tool")(
        evaluate
    )


@with_flags(
    "identify",
    seldom=(
        "sheet_order",
        "limits",
        "search_mm",
        "search_deg",
        "masses",
        "mass_sigma_percent",
        "com_sigma_mm",
        "socket_distances_mm",
    ),
)
def identify(
    robot: Robot,
    campaign: CampaignIds = None,
    validation: ValidationText = None,
    level: Annotated[int | None, typer.Option(min=1, max=3, help=IDENTIFY["level"])] = None,
    method: Annotated[
        str | None, typer.Option(help=IDENTIFY["method"] + " `kilter server methods` lists them.")
    ] = None,
    effects: Annotated[
        list[str] | None,
        typer.Option("--effects", "--effect", metavar="A,B", help=IDENTIFY["effects"] + AT_JOINTS),
    ] = None,
    refit: Refit = None,
    figures: Figures = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    check: Check = False,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Identify a robot's parameters from campaigns; the result is a new version."""
    needs_result(no_wait, figures=figures)
    chosen = arguments.options(option, level=level, method=method, effects=arguments.effects(effects))
    if refit is not None:
        chosen["refit"] = [] if refit == "none" else refit.split(",")
    drawn = partial(write_figures, figures, as_json)
    run_job(
        "identify",
        robot,
        campaign,
        validation,
        chosen,
        no_wait,
        as_json,
        files=drawn,
        name=name,
        check=check,
        details=details,
    )


@with_flags(
    "gap",
    seldom=(
        "max_effects",
        "bootstraps",
        "resamples",
        "permutations",
        "next_poses",
        "matters_um",
        "budget_s",
        "limits",
    ),
)
def gap(
    robot: Annotated[
        list[str],
        typer.Argument(
            help="Name of the robot; with --model logs of commands and readings.",
            metavar="ROBOT | LOG...",
            show_default=False,
        ),
    ],
    campaign: CampaignIds = None,
    validation: HuntValidation = None,
    confirmation: ConfirmationIds = None,
    effects: Annotated[
        list[str] | None,
        typer.Option("--effects", "--effect", metavar="A,B", help=GAP["effects"] + AT_JOINTS),
    ] = None,
    refit: Annotated[Literal["tool"] | None, typer.Option(help=OWN_TOOL)] = None,
    seed: Annotated[int | None, typer.Option(help=GAP["seed"])] = None,
    budget: Annotated[float | None, typer.Option(metavar="SECONDS", help=GAP["budget_s"])] = None,
    figures: Figures = None,
    poses: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the poses to measure next as CSV.", dir_okay=False)
    ] = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="A model of MuJoCo: what it lacks, by logs of commands and readings, no server needed; several are compared.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    joints: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A,B,C", help="With --model: its joints in the log's order; left out: all that have an actuator."
        ),
    ] = None,
    site: Annotated[str | None, typer.Option(help="With --model: its site at the tool.")] = None,
    payload_body: Annotated[
        str, typer.Option(help="With --model: the body whose mass is payload_kg of a log.")
    ] = "payload",
    calibration: Annotated[
        Path | None, typer.Option(help="With --model: the calibration of a LeRobot arm.", exists=True, dir_okay=False)
    ] = None,
    norm_mode: Annotated[str | None, typer.Option(help="With --model: the norm mode of a LeRobot data set.")] = None,
    column_map: Annotated[
        Path | None,
        typer.Option(
            "--map", help="With --model: column map of a log of other columns (TOML).", exists=True, dir_okay=False
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="With --model: write a copy that has what was found.", dir_okay=False),
    ] = None,
    form: Annotated[
        Literal["mjcf", "sdf", "usd", "isaaclab", "lerobot"],
        typer.Option(
            "--format",
            help="With --output: the model, SDF, USD, actuators of Isaac Lab, or LeRobot's calibration with found zeros.",
        ),
    ] = "mjcf",
    servos: Annotated[
        Literal["feetech", "dynamixel"] | None, typer.Option(help="With --format lerobot: whose servos they are.")
    ] = None,
    ranges: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --model: write ranges of what was found, and 100 draws of them together, as JSON (which is YAML).",
            dir_okay=False,
        ),
    ] = None,
    ranges_percent: Annotated[
        float, typer.Option(metavar="PERCENT", help="With --ranges: what they cover.", min=1.0, max=99.9)
    ] = 95.0,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    check: Check = False,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Find where the model is wrong, name what is missing, and show how the gap shrinks on rows never used.

    With --model: what a simulator's model lacks, by logs of commands and readings.
    """
    if model is not None:
        held = arguments.split_names(validation)
        asked = ModelSearch(
            model,
            held,
            joints,
            site,
            payload_body,
            output,
            calibration,
            norm_mode,
            column_map,
            ranges,
            ranges_percent,
            form,
            servos,
            seed,
        )
        return search_models(robot, asked, details, as_json)
    if len(robot) > 1 or output is not None:
        raise UsageError("Logs and --output go with --model MODEL.xml; a search on a server names one robot.")
    needs_result(no_wait, figures=figures, poses=poses)
    chosen = arguments.options(
        option,
        effects=arguments.effects(effects),
        seed=seed,
        budget_s=budget,
        refit=None if refit is None else [refit],
    )
    files = partial(_write_search, poses, figures, as_json)
    again = arguments.split_names(confirmation)
    run_job("gap", robot[0], campaign, validation, chosen, no_wait, as_json, True, files, again, name, check, details)


def _write_search(poses: Path | None, figures: Path | None, as_json: bool, job: dict[str, Any]) -> None:
    if poses is not None:
        write_poses(poses, (job.get("result") or {}).get("next_poses_csv"), as_json)
    write_figures(figures, as_json, job)


@with_flags("evaluate", seldom=("metrics", "criteria"))
def evaluate(
    robot: Robot,
    campaign: CampaignIds = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Compare a version with a campaign."""
    chosen = arguments.options(option)
    run_job("evaluate", robot, campaign, None, chosen, no_wait, as_json, name=name, details=details)


def needs_result(no_wait: bool, **files: Path | None) -> None:
    """Refuse files to write when nobody waits for the result."""
    for name, file in files.items():
        if no_wait and file is not None:
            raise UsageError(f"--{name} needs the result: leave out --no-wait.")


def write_poses(file: Path, text: str | None, as_json: bool) -> None:
    """Write poses as CSV and say how many."""
    if not text:
        note(f"{file}: not written: no pose would add information.", as_json)
        return
    write(file, text.encode())
    note(f"{file}: {text.count(chr(10)) - 1} poses", as_json)


def write_figures(folder: Path | None, as_json: bool, job: dict[str, Any]) -> None:
    """Write the figures of a job's result, if a folder was named, and say how many files."""
    drawn = (job.get("result") or {}).get("figures") or {}
    if folder is None:
        return
    formats = ("png", "svg") if can_draw() else ()
    if not formats:
        note("Without matplotlib the figures are Plotly JSON only: pip install matplotlib.", as_json)
    written = save_figures(drawn, folder, formats)
    note(f"{folder}: {len(written)} files", as_json)


def run_job(
    kind: str,
    robot: str,
    campaign: list[str] | None,
    validation: list[str] | None,
    options: dict[str, Any],
    no_wait: bool,
    as_json: bool,
    needs_campaign: bool = True,
    files: Callable[[dict[str, Any]], None] | None = None,
    confirmation: Sequence[str] = (),
    name: str = "",
    check: bool = False,
    details: bool = False,
) -> None:
    """Submit a job, follow it, and print it; or only say what it would do."""
    ids = arguments.split_names(campaign)
    if needs_campaign and not ids:
        raise UsageError(f"Name at least one --campaign ID: `kilter measure campaigns {robot}` lists them.")
    held_out = arguments.validation(validation)
    with Kilter() as kilter:
        ids = resolved_all(kilter, "campaign", ids, robot, as_json, "--campaign")
        again = resolved_all(kilter, "campaign", confirmation, robot, as_json, "--confirmation")
        if isinstance(held_out, list):
            held_out = resolved_all(kilter, "campaign", held_out, robot, as_json, "--validation")
        options = resolved_options(kilter, options, robot, as_json, {"version": "start"} if kind == "plan" else {})
        if check:
            told = kilter.jobs.check(kind, robot, ids, held_out, options, again, name)
            return finish_check(told, as_json, details)
        job = kilter.jobs.submit(kind, robot, ids, held_out, options, again, name)
        if not no_wait:
            with on_interrupt(partial(job_goes_on, job)), job_bar(kind, as_json) as progress:
                note(f"job: {job_name(job)}", as_json)
                job = kilter.jobs.wait(job["id"], progress)
        suggested = [] if as_json else suggest_after_job(kilter, job)
    if files is not None and not no_wait:
        files(job)
    emit(job, as_json, partial(show_job, details=details, head=False, suggested=suggested, server=kilter.url))
