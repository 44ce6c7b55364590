"""The options that describe a robot, the same for every command that reads one."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client.cli.terminal.arguments import PayloadCentre, three
from kilter_client.errors import UsageError
from kilter_files.robots import Described, checked_name, plain_name, read_robot

ROBOT_FILE = "robot.json, .urdf, a DH table (.csv, .xlsx), a UR calibration (.yaml, .conf), or a KNI .cfg."

# name of the option -> its type and help; every one may be left out
OPTIONS: dict[str, Any] = {
    "file": Annotated[Path | None, typer.Argument(help=ROBOT_FILE, exists=True, dir_okay=False, show_default=False)],
    "preset": Annotated[str | None, typer.Option(help="A robot that ships with Kilter, instead of a file.")],
    "name": Annotated[str | None, typer.Option(help="Name to give it; only robot.json has one.")],
    "payload_kg": Annotated[float | None, typer.Option(min=0.0, help="Payload where none is stated, kg.")],
    "payload_com_mm": PayloadCentre,
    "base_link": Annotated[
        str | None, typer.Option(help="URDF: first link of the chain; left out where only one can be it.")
    ],
    "tip_link": Annotated[
        str | None, typer.Option(help="URDF: last link of the chain; left out where only one can be it.")
    ],
    "convention": Annotated[str | None, typer.Option(help="Table: dh or mdh (Craig).", metavar="dh|mdh")],
    "model": Annotated[
        str | None, typer.Option(help="UR calibration: the model that it must match, for example ur10e.")
    ],
    "turned": Annotated[
        list[str] | None,
        typer.Option(help="A joint that the controller counts in the opposite direction; repeat for more."),
    ],
    "follows": Annotated[
        list[str] | None,
        typer.Option(
            help="A joint read against the horizontal, as FANUC's: j3=j2, or with who carries the load of that axis "
            "(linkage, controller, series) j3=j2:linkage; repeat for more.",
            metavar="J3=J2",
        ),
    ],
}


@dataclass(frozen=True)
class RobotSource:
    """What was given: a file or a preset, and what the file does not say itself."""

    file: Path | None
    preset: str | None
    described: Described
    load: dict[str, Any] | None = None
    words: tuple[str, ...] = ()  # as they are typed

    def document(self, unnamed: str | None = None) -> dict[str, Any]:
        """Return the robot document; ``unnamed`` is the name of a robot that was given none.

        A load that was given takes the place of the file's.

        Raises:
            UsageError: neither file nor preset, both, or options that belong to another kind of file.
            FileError: the file is not what it should be.

        """
        found = self._without_load(unnamed)
        return found if self.load is None else {**found, "load": self.load}

    def _without_load(self, unnamed: str | None) -> dict[str, Any]:
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
                "A preset is complete: --tip-link and --base-link belong to a .urdf file, the others to other files."
            )
        return {"name": described.name or self.preset, "convention": "preset", "preset": self.preset}


def takes_a_robot(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, whose first parameter is a ``RobotSource``, the options that name a robot."""
    own = [*inspect.signature(command, eval_str=True).parameters.values()][1:]
    given = [inspect.Parameter(name, _KEYWORD, default=None, annotation=kind) for name, kind in OPTIONS.items()]

    def run(**values: Any) -> None:
        shared = {name: values.pop(name) for name in OPTIONS}
        words = tuple(_words(shared))
        file, preset = shared.pop("file"), shared.pop("preset")
        load = _load(shared.pop("payload_kg"), shared.pop("payload_com_mm"))
        described: dict[str, Any] = {
            name: value or () if name in ("turned", "follows") else value for name, value in shared.items()
        }
        command(RobotSource(file, preset, Described(**described), load, words), **values)

    parameters = [parameter.replace(kind=_KEYWORD) for parameter in own]
    needed = [parameter for parameter in parameters if parameter.default is inspect.Parameter.empty]
    rest = [parameter for parameter in parameters if parameter not in needed]
    run.__signature__ = inspect.Signature([*needed, *given, *rest])  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in [*needed, *given, *rest]}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


def _words(given: Mapping[str, Any]) -> Iterator[str]:
    """The file and the options that name a robot, as they are typed."""
    for name, value in given.items():
        for one in value if isinstance(value, list) else [] if value is None else [value]:
            yield from ([] if name == "file" else [f"--{name.replace('_', '-')}"])
            yield str(one)


def _load(payload_kg: float | None, payload_com_mm: str | None) -> dict[str, Any] | None:
    """Return the default load that the options state.

    Raises:
        UsageError: a place without a mass, or no three numbers.

    """
    centre = three("--payload-com-mm", payload_com_mm)
    if payload_kg is None:
        if centre is not None:
            raise UsageError("--payload-com-mm says where the load has its centre: give --payload-kg beside it.")
        return None
    return {"payload_kg": payload_kg} | ({} if centre is None else {"payload_com_mm": centre})


_KEYWORD = inspect.Parameter.KEYWORD_ONLY
