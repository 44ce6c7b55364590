"""``kilter robot kit``: a low-cost arm from a board and a webcam to one page of what it has, in plain words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.files.sending import (
    refuse_other_servos,
    refuse_readings_outside,
    rig_conditions,
    send,
    servo_conditions,
)
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, job_bar, note, print_line
from kilter_client.cli.terminal.references import job_goes_on, on_interrupt
from kilter_client.errors import NotFoundError, UsageError
from kilter_client.files import files_rig
from kilter_files import prepare

LIMITS = {"max_joint_deg": 10.0, "max_position_mm": 60.0}  # a hobby servo is off by what would be a crash elsewhere
# Likely size of half a servo's backlash: with the prior of an industrial gear that of a worn one went into the joint's zero.
BACKLASH_RAD = math.radians(1.0)
# Load over which a gear changes flanks, N m: an empty wrist of such an arm carries up to 0.12, mostly less.
SOFTENING_NM = 0.005
PAYLOAD_SIGMA = {
    "mass_percent": 1.0,
    "com_mm": 10.0,
}  # it was weighed on a kitchen scale, and the jaw holds it about there
# Every view is predicted by a model that has not seen its pose, and the version has all of them. So few poses at a time, since
# few are those that tell backlash from a zero: of four folds one held out all of them, and was 9 mm off.
MOST_FOLDS = 12
SERVOS = ("so101", "so100", "koch", "lekiwi")  # presets of arms whose servos correct nothing by themselves


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter robot kit so101 views.csv --cameras views.json --calibration my_arm.json")(kit)


def kit(
    robot: Annotated[
        str, typer.Argument(help="Name of the arm; the name of a preset adds it.", metavar="ROBOT", show_default=False)
    ],
    views: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Views of `kilter measure see`, CSV; left out: what to do.",
            metavar="VIEWS",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option(
            "--cameras",
            metavar="FILE",
            help="Cameras and boards: the JSON that `kilter measure see` writes.",
            exists=True,
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", metavar="JSON", help="LeRobot's calibration of the servos.", exists=True),
    ] = None,
    anyway: Annotated[bool, typer.Option("--anyway", help="Identify although views are missing.")] = False,
    as_json: Json = False,
) -> None:
    """Take a low-cost arm from views to one page: what it has, how far off the tool is; exit code 4 where views are missing.

    Without VIEWS it says what to print, to drive and to photograph.
    """
    with Kilter() as kilter:
        arm = _arm(kilter, robot, as_json)
        if not views:
            emit({"robot": robot, "steps": files_rig.steps(robot)}, as_json, _show_steps)
            return
        if cameras is None or calibration is None:
            raise UsageError(
                "Give --cameras, the JSON beside the views, and --calibration, LeRobot's JSON of the servos."
            )
        names = [joint["name"] for joint in arm["joints"]]
        refuse_other_servos(calibration, names)
        rig = rig_conditions(cameras)
        seen = files_rig.capture_from_files(views, arm["joints"], kilter.robots.convert(arm["document"], "chain"), rig)
        refuse_readings_outside(calibration, views, names)
        document = {
            "robot": robot,
            "views": seen.views,
            "poses": seen.poses,
            "payloads_kg": list(seen.payloads_kg),
            "missing": list(seen.missing),
            "loads": [asdict(one) for one in seen.pulled],
        }
        if not seen.missing or anyway:
            conditions = rig | servo_conditions(calibration)
            sent = [_sent(robot, file, conditions, as_json) for file in views]
            folds = {"folds": min(MOST_FOLDS, seen.poses)}
            document |= _page(kilter, arm, sent, folds, seen.untold, as_json)
    emit(document, as_json, _show)
    if seen.missing and not anyway:
        raise typer.Exit(4)


def _arm(kilter: Kilter, robot: str, as_json: bool) -> dict[str, Any]:
    try:
        return dict(kilter.robots.get(robot))
    except NotFoundError:
        if robot not in SERVOS:
            raise
    note(f"{robot} is added from its preset", as_json)
    document = {"name": robot, "convention": "preset", "preset": robot, "controller_compensation": "none"}
    kilter.robots.add({**document, "payload_sigma": PAYLOAD_SIGMA})
    return dict(kilter.robots.get(robot))


def _sent(robot: str, file: Path, conditions: dict[str, Any], as_json: bool) -> str:
    wanted = {
        "name": file.name,
        "device": "camera",
        "role": "train",
        "conditions": conditions,
        "notes": "",
        "numbered": True,
        "measured_at": None,
    }
    return str(send(robot, None, wanted, file, prepare(file), as_json)["campaign_id"])


def _page(
    kilter: Kilter,
    arm: Mapping[str, Any],
    campaigns: Sequence[str],
    held_out: Mapping[str, int],
    untold: Mapping[int, str],
    as_json: bool,
) -> dict[str, Any]:
    """Identify, and say what came of it."""
    loaded = [*files_rig.gravity_loaded_joints(len(arm["joints"]))]
    effects = [
        {"id": "axial_compliance", "joints": loaded},
        {"id": "backlash_load", "joints": loaded, "softening_nm": SOFTENING_NM, "prior_sigma_rad": BACKLASH_RAD},
    ]
    # Masses are those of a public model: cables and another gripper weigh too, and decide the sign of a small load.
    options = {"effects": effects, "masses": "uncertain", "limits": LIMITS}
    job = kilter.jobs.submit("identify", arm["name"], list(campaigns), dict(held_out), options)
    with on_interrupt(partial(job_goes_on, job)), job_bar("identify", as_json) as progress:
        result = kilter.jobs.wait(job["id"], progress)["result"]
    version = str(result["version_id"])
    table = kilter.versions.export(version, "mdh-csv")
    return {"version_id": version, **files_rig.result_summary(result, arm["joints"], table, untold)}


def _show_steps(document: Mapping[str, Any]) -> None:
    for number, step in enumerate(document["steps"], 1):
        print_line(f"{number}. {step}")


def _show(document: Mapping[str, Any]) -> None:
    print_line(files_rig.describe_views(document["views"], document["poses"], document["payloads_kg"]))
    for line in document["missing"]:
        print_line(f"still missing: {line}")
    if "version_id" not in document:
        return
    print_line(files_rig.describe_tool_error(document["before_mm"], document["after_mm"]))
    for line in document["lines"] or [files_rig.NOTHING]:
        print_line(f"  {line}")
    for line in document["warnings"]:
        print_line(f"warning: {line}")
    print_line(f"version {document['version_id']}; correct with it: kilter activate {document['version_id']}")
