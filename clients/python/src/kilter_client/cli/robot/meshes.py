"""``kilter robot mesh``: the shapes of a robot's links, which the page draws."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.terminal.arguments import Json, Robot
from kilter_client.cli.terminal.output import emit, note, print_line, show_rows
from kilter_client.errors import UsageError
from kilter_client.requests.calls import robots
from kilter_client.verbs.robots import FORMS
from kilter_files.robots import link_meshes

mesh = typer.Typer(
    help="Give links their shapes, for the picture of the arm.", no_args_is_help=True, rich_markup_mode=None, cls=Group
)

Link = Annotated[str, typer.Argument(help="`base`, or the name of the joint that moves the link.", show_default=False)]
Packages = Annotated[
    list[str] | None,
    typer.Option("--package", metavar="NAME=FOLDER", help="Folder of a ROS package; repeat for more."),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.add_typer(mesh, name="mesh")


@mesh.command("list", epilog="Example: kilter robot mesh list katana450")
def list_(robot: Robot, as_json: Json = False) -> None:
    """List the shapes of a robot's links."""
    with Kilter() as kilter:
        document = {"meshes": kilter.run(robots.list_meshes(robot))}
    emit(document, as_json, _show)


@mesh.command("set", epilog="Example: kilter robot mesh set katana450 j2 upper-arm.stl --unit m")
def set_(
    robot: Robot,
    link: Link,
    file: Annotated[Path, typer.Argument(help="STL or OBJ.", exists=True, dir_okay=False, show_default=False)],
    unit: Annotated[Literal["mm", "m"], typer.Option(help="Unit of the file.")] = "mm",
    as_json: Json = False,
) -> None:
    """Give a link its shape: STL or OBJ, in the frame of the link's mass."""
    form = FORMS.get(file.suffix.lower())
    if form is None:
        raise UsageError(f"{file}: give a file that ends in .stl or .obj.")
    with Kilter() as kilter:
        found = kilter.run(robots.put_mesh(robot, link, file.read_bytes(), form, unit))
    emit({"meshes": [found]}, as_json, _show)


@mesh.command("from-urdf", epilog="Example: kilter robot mesh from-urdf arm arm_description/urdf/arm.urdf")
def from_urdf(
    robot: Robot,
    file: Annotated[
        Path, typer.Argument(help="The URDF it was added from.", exists=True, dir_okay=False, show_default=False)
    ],
    package: Packages = None,
    as_json: Json = False,
) -> None:
    """Send the shapes that a robot's URDF names: STL, OBJ, DAE, boxes, cylinders, spheres."""
    packages = dict(map(_package, package or ()))
    with Kilter() as kilter:
        asked = kilter.run(robots.list_urdf_meshes(robot))
        sent = []
        for one in link_meshes(asked["shapes"], file, packages):
            sent.append(kilter.run(robots.put_mesh(robot, one.link, one.content, "stl", "mm")))
            if one.triangles < one.before:
                note(f"{one.link}: simplified from {one.before} to {one.triangles} triangles", as_json)
    if asked["left_out"]:
        note(f"left out, behind joints that follow another: {', '.join(asked['left_out'])}", as_json)
    emit({"meshes": sent, "left_out": asked["left_out"]}, as_json, _show)


@mesh.command(epilog="Example: kilter robot mesh remove katana450 j2")
def remove(robot: Robot, link: Link, as_json: Json = False) -> None:
    """Delete the shape of a link: it is drawn as cylinders again."""
    with Kilter() as kilter:
        kilter.run(robots.remove_mesh(robot, link))
    emit({"removed": link}, as_json, lambda _: print_line(f"{link} is drawn as cylinders."))


def _package(text: str) -> tuple[str, Path]:
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise UsageError(f"--package {text}: give NAME=FOLDER.")
    return name, Path(folder)


def _show(document: dict[str, Any]) -> None:
    rows = [
        (one["link"], one["format"].upper(), one["unit"], f"{one['triangles']}", one["sha256"][:12])
        for one in document["meshes"]
    ]
    if rows:
        show_rows(("link", "format", "unit", "triangles", "SHA-256"), rows)
    else:
        print_line("No link has a shape: it is drawn as cylinders.")
