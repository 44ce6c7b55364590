"""``kilter hand-eye``: where cameras stand on a robot, and the files that ROS 2 needs of it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client.cli.analyse import needs_result, run_job
from kilter_client.cli.camera.ros_files import write_ros_files
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import CampaignIds, JobName, Json, MoreOptions, NoWait, Robot, ValidationText
from kilter_client.cli.terminal.output import note
from kilter_client.errors import UsageError


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command("hand-eye", epilog="Example: kilter hand-eye ur10 --campaign views --ros ros")(hand_eye)


def hand_eye(
    robot: Robot,
    campaign: CampaignIds = None,
    validation: ValidationText = None,
    kinematics: Annotated[
        Literal["fixed", "free"], typer.Option(help="free: the arm's errors are fitted beside the cameras.")
    ] = "fixed",
    start: Annotated[
        str | None, typer.Option(metavar="VERSION", help="Version whose arm is held, or begun with; the nominal one.")
    ] = None,
    ros: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write static transforms, camera_info and URDF for ROS 2.", file_okay=False),
    ] = None,
    base_link: Annotated[str, typer.Option(help="Name of the robot's base frame in ROS.")] = "base_link",
    flange_link: Annotated[str, typer.Option(help="Name of its flange frame in ROS.")] = "tool0",
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Find where cameras and boards stand on a robot: closed forms first, then all pixels at once.

    Makes a version that holds them; with fixed kinematics its arm is the one that it began with.
    """
    needs_result(no_wait, ros=ros)
    chosen = arguments.options(option, start=start)
    if kinematics == "fixed":
        chosen["fix"] = ["*"]
    files = partial(_write, ros, {"base": base_link, "flange": flange_link}, as_json)
    run_job("identify", robot, campaign, validation, chosen, no_wait, as_json, files=files, name=name)


def _write(folder: Path | None, frames: dict[str, str], as_json: bool, job: dict[str, Any]) -> None:
    result = job.get("result") or {}
    if not result.get("cameras"):
        raise UsageError("No camera measured in these campaigns: name some whose rows have pixels (`kilter see`).")
    for one in (*result["cameras"], *result["boards"]):
        place = ", ".join(f"{one[f'{k}_mm']:.3f}" for k in "xyz")
        turn = ", ".join(f"{one[f'r{k}_deg']:.4f}" for k in "xyz")
        note(f"{one['name']} in the {one['frame']}: {place} mm, roll pitch yaw {turn} deg", as_json)
    if folder is not None:
        for path in write_ros_files(result, folder, frames):
            note(str(path), as_json)
