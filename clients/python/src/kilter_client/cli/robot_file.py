"""The options by which a command is told a robot, the same for every command that reads one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client.errors import UsageError
from kilter_files.robots import Described, read_robot
from kilter_files.robots.plain_name import checked_name, plain_name

ROBOT_FILE = "robot.json, .urdf, a DH table (.csv, .xlsx), a UR calibration (.yaml), or a KNI .cfg."

# name of the option -> its type and help; every one may be left out
OPTIONS: dict[str, Any] = {
    "file": Annotated[Path | None, typer.Argument(help=ROBOT_FILE, exists=True, dir_okay=False, show_default=False)],
    "preset": Annotated[str | None, typer.Option(help="A robot that ships with Kilter, instead of a file.")],
    "name": Annotated[str | None, typer.Option(help="Name to give it; only robot.json has one.")],
    "base_link": Annotated[str | None, typer.Option(help="URDF: first link of the chain.")],
    "tip_link": Annotated[str | None, typer.Option(help="URDF: last link of the chain.")],
    "convention": Annotated[str | None, typer.Option(help="Table: dh or mdh (Craig).", metavar="dh|mdh")],
    "model": Annotated[str | None, typer.Option(help="UR calibration: the model it must be of, for example ur10e.")],
    "turned": Annotated[
        list[str] | None, typer.Option(help="A joint the controller counts backwards; repeat for more.")
    ],
    "follows": Annotated[
        list[str] | None,
        typer.Option(help="A joint read against the horizontal, as FANUC's: j3=j2; repeat for more.", metavar="J3=J2"),
    ],
}


@dataclass(frozen=True)
class RobotSource:
    """What was given: a file or a preset, and what the file does not say itself."""

    file: Path | None
    preset: str | None
    described: Described

    def document(self, unnamed: str | None = None) -> dict[str, Any]:
        """Return the robot document; ``unnamed`` is the name of a robot that was given none.

        Raises:
            UsageError: neither file nor preset, both, or options that belong to another kind of file.
            FileError: the file is not what it should be.

        """
        if (self.file is None) == (self.preset is None):
            raise UsageError("Give either a FILE or --preset.")
        name = checked_name(self.described.name) if self.described.name else unnamed and plain_name(unnamed)
        described = replace(self.described, name=name)
        if self.file is not None:
            document = read_robot(self.file, described)
            if isinstance(document.get("name"), str):
                checked_name(document["name"])
            return document
        if replace(described, name=None) != Described():
            raise UsageError(
                "A preset is whole: --tip-link and --base-link belong to a .urdf file, the others to other files."
            )
        return {"name": described.name or self.preset, "convention": "preset", "preset": self.preset}


def takes_a_robot(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, whose first parameter is a ``RobotSource``, the options that name a robot."""
    own = [*inspect.signature(command, eval_str=True).parameters.values()][1:]
    given = [inspect.Parameter(name, _KEYWORD, default=None, annotation=kind) for name, kind in OPTIONS.items()]

    def run(**values: Any) -> None:
        shared = {name: values.pop(name) for name in OPTIONS}
        file, preset = shared.pop("file"), shared.pop("preset")
        described: dict[str, Any] = {
            name: value or () if name in ("turned", "follows") else value for name, value in shared.items()
        }
        command(RobotSource(file, preset, Described(**described)), **values)

    parameters = [parameter.replace(kind=_KEYWORD) for parameter in own]
    needed = [parameter for parameter in parameters if parameter.default is inspect.Parameter.empty]
    rest = [parameter for parameter in parameters if parameter not in needed]
    run.__signature__ = inspect.Signature([*needed, *given, *rest])  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in [*needed, *given, *rest]}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


_KEYWORD = inspect.Parameter.KEYWORD_ONLY
