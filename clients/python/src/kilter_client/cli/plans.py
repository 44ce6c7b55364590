"""``kilter plan``: poses to measure, and the few poses of a check."""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from kilter_client.cli.analyse import AT_JOINTS, needs_result, run_job, write_poses
from kilter_client.cli.groups import WithDefault
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import (
    CampaignIds,
    JobName,
    Json,
    MoreOptions,
    NoWait,
    PayloadCentre,
    Robot,
    with_flags,
)
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
            "--output",
            "-o",
            metavar="FILE",
            help="Write them as CSV, or as a program: .script, .mod, .src, .ls.",
            dir_okay=False,
        ),
    ] = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Plan motions that show bodies and friction, to be recorded with their torques."""
    needs_result(no_wait, output=output)
    if output is not None:
        refuse_other_endings(output)
    files = partial(_write_motions, output, as_json)
    chosen = arguments.options(option)
    run_job("motion_plan", robot, None, None, chosen, no_wait, as_json, needs_campaign=False, files=files, name=name)


def _write_motions(output: Path | None, as_json: bool, job: Mapping[str, Any]) -> None:
    text = (job.get("result") or {}).get("csv")
    if output is not None and text:
        write(output, write_motions(output, str(job["robot"]), text).encode())
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


# Planned motions as programs that a controller follows in their time.

Floats = NDArray[np.float64]
CSV = ".csv"
AXES = 6
STEP_S = 0.1  # between targets that a controller blends; a servo gets every row
STILL_DEG = 1e-4  # from the posture between motions
FIRST_DEG_S = 10.0  # on the way to the first posture
TP_COMMENT = 32  # characters of a comment of a TP program
TP_TIMES = "Moves are blended: times are about these. Log what is driven."
UNUSED = "9E9"  # an external axis that is not there
SAID = ("Planned motions of {name}: {seconds:.0f} s.", "Nobody checked them for collisions: run them slowly first.")


def refuse_other_endings(output: Path) -> None:
    """Refuse a file whose ending names no dialect, with a UsageError."""
    if output.suffix.lower() not in (CSV, *DIALECTS):
        raise UsageError(f"{output}: motions are written as {CSV}, {', '.join(DIALECTS)}; name one of these.")


def write_motions(output: Path, robot: str, text: str) -> str:
    """Return what a file holds of the motions in ``text`` (CSV: t_s and joints): that, or a program where its name ends so.

    Raises:
        UsageError: the arm does not have the axes that the program moves.

    """
    ending = output.suffix.lower()
    if ending == CSV:
        return text
    head, *rows = csv.reader(io.StringIO(text))
    fewest, most, write = DIALECTS[ending]
    if not all(one.endswith("_deg") for one in head[1:]) or not fewest <= len(head) - 1 <= most:
        axes = "6" if fewest == most else "up to 6"
        raise UsageError(
            f"{output}: such a program moves {axes} revolute joints, and this arm has {', '.join(head[1:])}: write {CSV}."
        )
    table = np.array(rows, dtype=np.float64)
    comments = [one.format(name=robot, seconds=table[-1, 0]) for one in SAID]
    return "\n".join([*write(comments, table[:, 0], table[:, 1:]), ""])


def _write_urscript(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    """Every row as a target of the servo, which holds its time."""
    radians = [f"[{', '.join(f'{value:.6f}' for value in row)}]" for row in np.radians(q).tolist()]
    first = np.radians(FIRST_DEG_S)
    moves = [
        f"  servoj({place}, 0, 0, {step:.4f}, 0.1, 300)" for place, step in zip(radians[1:], np.diff(t), strict=True)
    ]
    begin = ["def kilter_motions():", f"  movej({radians[0]}, a=0.5, v={first:.3f})", "  sleep(1.0)"]
    return [*(f"# {one}" for one in comments), *begin, *moves, "  stopj(1.0)", "end", "kilter_motions()"]


def _write_rapid(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    targets = [_rapid_target(row) for row in q.tolist()]
    lines = ["MODULE KilterMotions", *(f"  ! {one}" for one in comments), "  PROC kilter_motions()"]
    lines.append(f"    MoveAbsJ {targets[0]},v50,fine,tool0;")
    for rest_s, steps in _list_motions(t, q):
        lines.append(f"    WaitTime {rest_s:.3f};")
        lines += [f"    MoveAbsJ {targets[k]},v200\\T:={span:.3f},z10,tool0;" for k, span in steps]
    return [*lines, "  ENDPROC", "ENDMODULE"]


def _rapid_target(row: Sequence[float]) -> str:
    axes = [*row, *([0.0] * (AXES - len(row)))]
    return f"[[{','.join(f'{value:.4f}' for value in axes)}],[{','.join([UNUSED] * AXES)}]]"


def _write_krl(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    """A spline block for each motion, whose whole time is given and divided."""
    targets = [f"{{{', '.join(f'A{j + 1} {value:.4f}' for j, value in enumerate(row))}}}" for row in q.tolist()]
    lines = ["DEF kilter_motions()", *(f"; {one}" for one in comments), "BAS(#INITMOV,0)", "BAS(#VEL_PTP,10)"]
    lines.append(f"PTP {targets[0]}")
    for rest_s, steps in _list_motions(t, q):
        lines += [f"WAIT SEC {rest_s:.3f}", "PTP_SPLINE", "  TIME_BLOCK START"]
        lines += [line for k, span in steps for line in (f"  SPTP {targets[k]}", f"  TIME_BLOCK PART = {span:.3f}")]
        lines += [f"  TIME_BLOCK END = {sum(span for _, span in steps):.3f}", "ENDSPLINE"]
    return [*lines, "END"]


def _write_tp(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    """Joint moves of so many ms each. A controller blends them by its own rule, so a motion takes about its time."""
    words = [line for one in (*comments, TP_TIMES) for line in textwrap.wrap(one, TP_COMMENT)]
    moves, shown = [*(f"!{line}" for line in words), "J P[1] 10% FINE"], [0]
    for rest_s, steps in _list_motions(t, q):
        moves.append(f"WAIT {rest_s:.2f}(sec)")
        for k, span in steps:
            shown.append(k)
            end = "FINE" if k == steps[-1][0] else "CNT100"
            moves.append(f"J P[{len(shown)}] {max(1, round(1e3 * span))}msec {end}")
    head = ["/PROG KILTER_MOTIONS", "/ATTR", "DEFAULT_GROUP = 1,*,*,*,*;", "/MN"]
    places = [
        f"P[{n}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t"
        + ", ".join(f"J{j} = {value:.3f} deg" for j, value in enumerate(q[k].tolist(), 1))
        + "\n};"
        for n, k in enumerate(shown, 1)
    ]
    return [*head, *(f"{n:4}:{move} ;" for n, move in enumerate(moves, 1)), "/POS", *places, "/END"]


def _list_motions(t: Floats, q: Floats) -> Iterator[tuple[float, list[tuple[int, float]]]]:
    """Of each motion the seconds of rest before it, then its targets: rows, and the seconds that the way to each takes."""
    away = np.any(np.abs(q - q[0]) > STILL_DEG, axis=1)
    edges = np.flatnonzero(np.diff(away.astype(np.int64), prepend=0, append=0))
    usual, rested = max(1, round(STEP_S / float(np.median(np.diff(t))))), 0
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, last = max(first - 1, 0), min(end, len(t) - 1)
        rows = [*range(begin + usual, last - usual // 2, usual), last]
        steps = [(k, float(t[k] - t[j])) for j, k in pairwise([begin, *rows])]
        yield float(t[begin] - t[rested]), steps
        rested = last


DIALECTS: dict[str, tuple[int, int, Callable[[Sequence[str], Floats, Floats], list[str]]]] = {
    ".script": (AXES, AXES, _write_urscript),
    ".mod": (1, AXES, _write_rapid),
    ".src": (1, AXES, _write_krl),
    ".ls": (1, AXES, _write_tp),
}
