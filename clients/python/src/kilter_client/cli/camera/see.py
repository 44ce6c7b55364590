"""``kilter measure see``: boards in pictures become rows of pixels."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from kilter_client.cli.files.inspect import check_numpy
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, print_line, upload_bar
from kilter_client.errors import FileError, UsageError
from kilter_client.files import files_formats, files_rig
from kilter_client.results.rows import write_file
from kilter_files.formats import LogHints
from kilter_files.rig import check_pyarrow, read_camera, write_parquet

if TYPE_CHECKING:
    from kilter_files.rig import Looker, Pictures, Poses, Seen

CONVENTION = "the centre of the upper left pixel is (0, 0), u to the right, v down"
PARQUET = ".parquet"
SHOWN = 8
Joints = Annotated[
    Path | None,
    typer.Option(
        help="Joints of every picture: by a column picture, by t_s for videos, else in the order of the names.",
        exists=True,
        dir_okay=False,
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        help="Intrinsics: a camera_info of ROS, a camchain of Kalibr, YAML or XML of OpenCV, or views.json.",
        exists=True,
        dir_okay=False,
    ),
]
Lens = Annotated[
    Literal["none", "brown", "rational", "fisheye"] | None,
    typer.Option(help="Find the intrinsics from the views, with a lens of this model."),
]

Given = Annotated[
    list[Path],
    typer.Argument(
        help="Pictures, folders of them, videos, or a bag of ROS.", metavar="PICTURES...", show_default=False
    ),
]
Topic = Annotated[str | None, typer.Option(help="Of a bag: the topic of the pictures.", show_default=False)]
JointsTopic = Annotated[
    str | None, typer.Option("--joints-topic", metavar="TOPIC", help="Of a bag: the topic of the joints.")
]
JointOrder = Annotated[
    str | None, typer.Option("--joint-order", metavar="NAMES", help="Of a bag: its joints from the base to the tool.")
]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure see pictures --board board.json --joints joints.csv -o views.csv")(see)


def see(
    pictures: Given,
    board: Annotated[
        list[Path],
        typer.Option(
            help="JSON of the board, from kilter measure board; repeat for more.", exists=True, dir_okay=False
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE", help="views.csv or views.parquet; cameras and boards beside it, as JSON."
        ),
    ],
    joints: Joints = None,
    camera: CameraFile = None,
    intrinsics: Lens = None,
    mount: Annotated[
        Literal["fixed", "flange"], typer.Option(help="Where the camera is; the board is on the other side.")
    ] = "fixed",
    camera_name: Annotated[
        str | None, typer.Option("--camera-name", metavar="NAME", help="Name of this camera, of several.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Of a video: every how many frames.")] = 1,
    starts_s: Annotated[float, typer.Option(help="Time of the joint log at which the video begins.")] = 0.0,
    cross_check: Annotated[
        bool, typer.Option("--cross-check", help="Compare AprilTag corners with those of a second detector.")
    ] = False,
    topic: Topic = None,
    joints_topic: JointsTopic = None,
    joint_order: JointOrder = None,
    as_json: Json = False,
) -> None:
    """Find boards in pictures: pixels of their corners with their standard deviations, row by row with the joints."""
    check_numpy()
    _check_output(output)
    if camera is not None and intrinsics is not None:
        raise UsageError("Give --camera, or --intrinsics to find them, not both.")
    targets = [files_rig.read_target(path) for path in board]
    files_rig.check_apart(targets)
    known = None if camera is None else read_camera(camera, camera_name)
    order = tuple(joint_order.split(",")) if joint_order else ()
    bag = _bag(pictures, joints, every, topic, joints_topic, order)
    source, poses = bag or _files(pictures, joints, every, starts_s)
    looker = files_rig.Looker(
        targets, poses, known, intrinsics, files_rig.create_second_detector(targets) if cross_check else None
    )
    seen = _write_views_file(looker, source, output, camera_name, as_json)
    document = views_document(seen, looker, mount, camera_name)
    beside = output.with_suffix(".json")
    write_file((json.dumps(document, indent=1) + "\n").encode(), beside)
    emit({"file": str(output), "description": str(beside)} | document, as_json, _show)


def _files(pictures: list[Path], joints: Path | None, every: int, starts_s: float) -> tuple[Pictures, Poses | None]:
    source = files_rig.gather_source(pictures, every)
    return source, None if joints is None else files_rig.read_poses(
        joints, source.count(), bool(source.videos), starts_s
    )


def _bag(
    pictures: list[Path],
    joints: Path | None,
    every: int,
    topic: str | None,
    joints_topic: str | None,
    order: tuple[str, ...],
) -> tuple[Pictures, Poses] | None:
    """The pictures and joints of a bag; None of files."""
    if not any(map(files_rig.is_bag, pictures)):
        if topic or joints_topic or order:
            raise UsageError("--topic, --joints-topic and --joint-order are of a bag: name its folder or file.")
        return None
    if len(pictures) > 1:
        raise UsageError(f"{pictures[0]}: give one bag at a time, and nothing beside it.")
    if joints is not None:
        raise UsageError(f"{pictures[0]}: joints of a bag are its own (--joints-topic); leave --joints out.")
    found = files_rig.pictures_of_bag(
        pictures[0], topic, files_formats.log_of_bag(pictures[0], LogHints(joints_topic, order)), every
    )
    return found, found.poses()


def _check_output(output: Path) -> None:
    if output.suffix.lower() not in (".csv", PARQUET):
        raise UsageError(f"--output {output}: end it in .csv or {PARQUET}.")
    if output.suffix.lower() == PARQUET:
        check_pyarrow(output)


def _write_views_file(looker: Looker, source: Pictures, output: Path, camera_name: str | None, as_json: bool) -> Seen:
    """Write beside the file first: what was there stays until all is well."""
    part, whole = (output.with_name(output.name + ending) for ending in (".part", ".whole"))
    total = source.count()
    try:
        bar = upload_bar(f"{total} pictures", as_json, "looking through")
        with bar as told, part.open("w", encoding="utf-8", newline="") as stream:
            seen = looker.write_views(source, stream, camera_name, lambda seen: told(seen.pictures, total))
        if output.suffix.lower() == PARQUET:
            write_parquet(part, whole)
            whole.replace(output)
        else:
            part.replace(output)
    except OSError as error:
        raise FileError(f"{output}: cannot be written: {error.strerror or error}.", file=str(output)) from error
    finally:
        for left in (part, whole):
            left.unlink(missing_ok=True)
    return seen


def views_document(seen: Seen, looker: Looker, mount: str, camera_name: str | None) -> dict[str, Any]:
    """Return what the JSON file holds."""
    other = "flange" if mount == "fixed" else "fixed"
    cameras = []
    if looker.camera is not None:
        one = looker.camera.to_document()
        cameras = [one | {"name": camera_name or one["name"], "mount": mount}]
    return {
        "rows": len(seen.views),
        "pictures": seen.pictures,
        "corners": seen.corners,
        "pixels": CONVENTION,
        "cameras": cameras,
        "boards": [target.to_document() | {"mount": other} for target in looker.targets],
        **({"intrinsics": seen.intrinsics} if seen.intrinsics else {}),
        **({"cross_check": looker.second.to_document()} if looker.second else {}),
        "views": seen.views,
        "refused": [refusal.to_document() for refusal in seen.refused],
        "refused_by_code": seen.counts(),
        "warnings": seen.warnings,
    }


def _show(document: dict[str, Any]) -> None:
    rows, pictures = document["rows"], document["pictures"]
    print_line(f"{document['file']}: {rows} views of {pictures} pictures, {document['corners']} corners")
    sigmas = sorted(view["sigma_px"] for view in document["views"])
    print_line(
        f"  Standard deviation of a corner by the pictures: {sigmas[len(sigmas) // 2]:.3f} px, median of the views"
    )
    if fit := document.get("intrinsics"):
        one = document["cameras"][0]
        pairs = zip(("fx", "fy", "cx", "cy"), one["sigmas_px"], strict=False)
        numbers = ", ".join(f"{name} {one[f'{name}_px']:.2f} ± {sigma:.2f}" for name, sigma in pairs)
        print_line(
            f"  Intrinsics ({fit['model']}): {numbers} px; {fit['rms_px']:.3f} px rms left in {fit['views']} views"
        )
    if other := document.get("cross_check"):
        apart = f"{other['mean_u_px']:+.3f}, {other['mean_v_px']:+.3f} px on average, {other['rms_px']:.3f} px rms"
        print_line(f"  {other['detector']} on {other['corners']} corners: ours are {apart} from its")
    for text in document["warnings"]:
        print_line(f"  Warning: {text}.")
    for refusal in document["refused"][:SHOWN]:
        print_line(f"  Refused ({refusal['code']}): {refusal['picture']}: {refusal['detail']}. {refusal['remedy']}")
    if len(document["refused"]) > SHOWN:
        print_line(f"  ... and {len(document['refused']) - SHOWN} more, all in {document['description']}")
