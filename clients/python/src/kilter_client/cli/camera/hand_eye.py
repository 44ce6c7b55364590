"""``kilter measure hand-eye``: where cameras stand on a robot, and the files that ROS 2 needs of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client.cli.analyse import needs_result, run_job
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import CampaignIds, JobName, Json, MoreOptions, NoWait, Robot, ValidationText
from kilter_client.cli.terminal.output import note
from kilter_client.errors import FileError, UsageError
from kilter_client.results.rows import write_file

Part = Mapping[str, Any]
MODELS = {"none": "plumb_bob", "brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}
COUNTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def ros_files(result: Mapping[str, Any], frames: Mapping[str, str]) -> dict[str, str]:
    """Name and text of each file; ``frames`` are the names of the robot's `base` and `flange`."""
    parts = [(f"{one['name']}_optical_frame", one) for one in result["cameras"]]
    parts += [(f"{one['name']}_board", one) for one in result["boards"]]
    files = {
        "static_transforms.yaml": _transforms(parts, frames),
        "static_transforms.sh": "".join(_command(child, one, frames) for child, one in parts),
        "hand_eye.urdf.xacro": _urdf(parts, frames),
    }
    return files | {f"camera_info_{one['name']}.yaml": camera_info(one) for one in result["cameras"]}


def write_ros_files(result: Mapping[str, Any], folder: Path, frames: Mapping[str, str]) -> list[Path]:
    """Write the files into a folder.

    Raises:
        FileError: the folder or a file cannot be written.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: cannot be made: {error.strerror or error}.", file=str(folder)) from error
    return [write_file(text.encode(), folder / name) for name, text in ros_files(result, frames).items()]


def quaternion(part: Part) -> tuple[float, float, float, float]:
    """Rotation x, y, z, w of roll, pitch and yaw (URDF)."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(0.5 * a), math.sin(0.5 * a)) for a in (math.radians(part[f"r{k}_deg"]) for k in "xyz")
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _metres(part: Part) -> tuple[float, float, float]:
    x, y, z = (1e-3 * part[f"{k}_mm"] for k in "xyz")
    return x, y, z


def _transforms(parts: list[tuple[str, Part]], frames: Mapping[str, str]) -> str:
    lines = ["# Of geometry_msgs/TransformStamped: metres, quaternions."]
    for child, one in parts:
        values = zip(("x", "y", "z"), _metres(one), strict=True), zip("xyzw", quaternion(one), strict=True)
        place, turn = ("{" + ", ".join(f"{k}: {v:.9f}" for k, v in pairs) + "}" for pairs in values)
        lines += [f"- parent: {frames[one['frame']]}", f"  child: {child}", f"  translation: {place}"]
        lines += [f"  rotation: {turn}"]
    return "\n".join(lines) + "\n"


def _command(child: str, one: Part, frames: Mapping[str, str]) -> str:
    numbers = [f"--{k} {v:.9f}" for k, v in zip("xyz", _metres(one), strict=True)]
    numbers += [f"--q{k} {v:.9f}" for k, v in zip("xyzw", quaternion(one), strict=True)]
    names = f"--frame-id {frames[one['frame']]} --child-frame-id {child}"
    return f"ros2 run tf2_ros static_transform_publisher {' '.join(numbers)} {names} &\n"


def _urdf(parts: list[tuple[str, Part]], frames: Mapping[str, str]) -> str:
    lines = ['<?xml version="1.0"?>', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">']
    for child, one in parts:
        xyz = " ".join(f"{v:.9f}" for v in _metres(one))
        rpy = " ".join(f"{math.radians(one[f'r{k}_deg']):.9f}" for k in "xyz")
        lines += [
            f'  <link name="{child}"/>',
            f'  <joint name="{child}_joint" type="fixed">',
            f'    <parent link="{frames[one["frame"]]}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>"]) + "\n"


def camera_info(one: Part) -> str:
    """Intrinsics as ROS's camera_calibration writes them."""
    model = MODELS[one["distortion_model"]]
    numbers = [*one["distortion"], *(0.0,) * (COUNTS[model] - len(one["distortion"]))]
    fx, fy, cx, cy = (float(one[f"{k}_px"]) for k in ("fx", "fy", "cx", "cy"))
    matrices = {
        "camera_matrix": (3, 3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        "distortion_coefficients": (1, len(numbers), numbers),
        "rectification_matrix": (3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": (3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    }
    lines = [f"image_width: {one['width_px']}", f"image_height: {one['height_px']}", f"camera_name: {one['name']}"]
    for name, (rows, columns, values) in matrices.items():
        if name == "distortion_coefficients":
            lines.append(f"distortion_model: {model}")
        data = ", ".join(f"{v:.12g}" for v in values)
        lines += [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{data}]"]
    return "\n".join(lines) + "\n"


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command("hand-eye", epilog="Example: kilter measure hand-eye ur10 --campaign views --ros ros")(hand_eye)


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
        raise UsageError(
            "No camera measured in these campaigns: name some whose rows have pixels (`kilter measure see`)."
        )
    for one in (*result["cameras"], *result["boards"]):
        place = ", ".join(f"{one[f'{k}_mm']:.3f}" for k in "xyz")
        turn = ", ".join(f"{one[f'r{k}_deg']:.4f}" for k in "xyz")
        note(f"{one['name']} in the {one['frame']}: {place} mm, roll pitch yaw {turn} deg", as_json)
    if folder is not None:
        for path in write_ros_files(result, folder, frames):
            note(str(path), as_json)
