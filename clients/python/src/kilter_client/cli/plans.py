"""``kilter plan``: poses to measure, and the few poses of a check."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client.cli.analyse import AT_JOINTS, needs_result, run_job, write_poses
from kilter_client.cli.groups import WithDefault
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import CampaignIds, JobName, Json, MoreOptions, NoWait, PayloadCentre, Robot
from kilter_client.cli.terminal.flags import with_flags
from kilter_client.cli.terminal.output import note
from kilter_client.errors import UsageError
from kilter_client.typed.option_texts import PLAN

SELDOM = ("method", "version", "box_mm", "keep_out_mm", "within", "payloads_kg")
Box = Annotated[str | None, typer.Option(metavar="X,Y,Z,X,Y,Z", help=PLAN["box_mm"])]
KeepOut = Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,X,Y,Z", help=PLAN["keep_out_mm"])]
Anywhere = Annotated[
    bool, typer.Option("--anywhere", help="Also where the robot was never driven: only its limits count.")
]
Views = Annotated[
    bool,
    typer.Option("--views", help="Poses for cameras: at each a board is whole in a picture."),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="Write the poses as CSV, with loads and directions where they matter.",
        dir_okay=False,
    ),
]


class PosesByDefault(WithDefault):
    """A group whose ``poses`` may be left out."""

    by_default = "poses"


group = typer.Typer(
    help="Plan poses to measure; without a command, for the purpose that is named.",
    rich_markup_mode=None,
    no_args_is_help=True,
    cls=PosesByDefault,
)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    group.command(
        epilog="Example: kilter plan poses ur10 --purpose separate --effects backlash,eccentricity -o poses.csv"
    )(poses)
    group.command(epilog="Example: kilter plan check ur10 --poses 5 -o check.csv")(check)
    group.command(epilog="Example: kilter plan motion ur10 --seconds 40 -o motions.csv")(motion)
    app.add_typer(group, name="plan")


@with_flags("plan", seldom=(*SELDOM, "without_joints"))
def poses(
    robot: Robot,
    campaign: CampaignIds = None,
    purpose: Annotated[str | None, typer.Option(help=PLAN["purpose"])] = None,
    count: Annotated[int | None, typer.Option(min=1, help=PLAN["count"])] = None,
    effects: Annotated[
        list[str] | None, typer.Option("--effects", "--effect", metavar="A,B", help=PLAN["effects"] + AT_JOINTS)
    ] = None,
    start: Annotated[str | None, typer.Option(metavar="VERSION", help=PLAN["version"])] = None,
    prior: Annotated[Literal["fleet"] | None, typer.Option(help=PLAN["prior"])] = None,
    floor_mm: Annotated[float | None, typer.Option("--floor", metavar="MM", help=PLAN["floor_mm"])] = None,
    box: Box = None,
    keep_out: KeepOut = None,
    anywhere: Anywhere = False,
    views: Views = False,
    payload_kg: Annotated[str | None, typer.Option(metavar="KG,KG", help=PLAN["payloads_kg"])] = None,
    payload_com_mm: PayloadCentre = None,
    output: Output = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Plan poses to measure: for ISO 9283, to identify well, or to distinguish two effects."""
    needs_result(no_wait, output=output)
    chosen = arguments.options(
        option,
        purpose=purpose or ("identify" if views or prior else None),
        method="views" if views else None,
        count=count,
        effects=arguments.effects(effects),
        version=start,
        prior=prior,
        floor_mm=floor_mm,
        box_mm=_corners(box),
        keep_out_mm=_zones(keep_out),
        within="limits" if anywhere else None,
        payloads_kg=None if payload_kg is None else arguments.numbers("--payload-kg", payload_kg),
        payload_com_mm=arguments.three("--payload-com-mm", payload_com_mm),
    )
    files = partial(_write, output, as_json)
    run_job("plan", robot, campaign, None, chosen, no_wait, as_json, needs_campaign=False, files=files, name=name)


@with_flags("plan", seldom=(*SELDOM, "purpose", "count", "effects", "prior", "payload_com_mm"))
def check(
    robot: Robot,
    poses: Annotated[int, typer.Option("--poses", "--count", min=3, help="How many poses.")] = 5,
    start: Annotated[str | None, typer.Option(metavar="VERSION", help=PLAN["version"])] = None,
    floor_mm: Annotated[float | None, typer.Option("--floor", metavar="MM", help=PLAN["floor_mm"])] = None,
    box: Box = None,
    keep_out: KeepOut = None,
    anywhere: Anywhere = False,
    without_joints: Annotated[str | None, typer.Option(metavar="6,7", help=PLAN["without_joints"])] = None,
    output: Output = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Plan the few poses that best show whether the arm has moved, and say which changes they will show."""
    needs_result(no_wait, output=output)
    joints = None if without_joints is None else [int(k) for k in arguments.numbers("--without-joints", without_joints)]
    chosen = arguments.options(
        option,
        purpose="check",
        count=poses,
        version=start,
        floor_mm=floor_mm,
        box_mm=_corners(box),
        keep_out_mm=_zones(keep_out),
        within="limits" if anywhere else None,
        without_joints=joints,
    )
    files = partial(_write, output, as_json)
    run_job("plan", robot, None, None, chosen, no_wait, as_json, needs_campaign=False, files=files, name=name)


@with_flags("motion_plan", seldom=("rate_hz", "speed_mm_s"))
def motion(
    robot: Robot,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Write the motions as CSV: t_s and joints.", dir_okay=False
        ),
    ] = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Plan motions that show bodies and friction, to be recorded with their torques."""
    needs_result(no_wait, output=output)
    files = partial(_write_motions, output, as_json)
    chosen = arguments.options(option)
    run_job("motion_plan", robot, None, None, chosen, no_wait, as_json, needs_campaign=False, files=files, name=name)


def _write_motions(output: Path | None, as_json: bool, job: Mapping[str, Any]) -> None:
    text = (job.get("result") or {}).get("csv")
    if output is not None and text:
        write(output, text.encode())
        note(f"{output}: {text.count(chr(10)) - 1} rows", as_json)


def _write(output: Path | None, as_json: bool, job: Mapping[str, Any]) -> None:
    """Write the poses of a job where that was asked for."""
    if output is not None:
        write_poses(output, (job.get("result") or {}).get("csv"), as_json)


def _zones(texts: list[str] | None) -> list[list[list[float]]] | None:
    """Understand --keep-out."""
    found = [_corners(text, "--keep-out") for text in texts or ()]
    return [box for box in found if box is not None] or None


def _corners(text: str | None, option: str = "--box") -> list[list[float]] | None:
    """Understand the corners of a box."""
    if text is None:
        return None
    given = arguments.numbers(option, text)
    if len(given) != 6:
        raise UsageError(f"{option} {text}: give six numbers, the lowest and the highest corner in mm.")
    if not all(low < high for low, high in zip(given[:3], given[3:], strict=True)):
        raise UsageError(f"{option} {text}: give the lowest corner first, for example -200,100,0,200,400,300 (mm).")
    return [given[:3], given[3:]]
