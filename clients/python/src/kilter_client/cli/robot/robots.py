"""``kilter robot``: describe robots, by options that every command shares that reads one."""

from __future__ import annotations

import inspect
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.reports.answer import DETAILS, PLACEHOLDER, fit_messages, format_next
from kilter_client.cli.robot import circles
from kilter_client.cli.robot.arm_figure import save_arm
from kilter_client.cli.stored import keeping
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import Details, Json, PayloadCentre, Retired, Robot, three
from kilter_client.cli.terminal.output import (
    emit,
    is_note_due,
    note,
    print_line,
    print_lines,
    screen_columns,
    show_list,
    show_rows,
)
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
    """Return the default load that the options state."""
    centre = three("--payload-com-mm", payload_com_mm)
    if payload_kg is None:
        if centre is not None:
            raise UsageError("--payload-com-mm says where the load has its centre: give --payload-kg beside it.")
        return None
    return {"payload_kg": payload_kg} | ({} if centre is None else {"payload_com_mm": centre})


_KEYWORD = inspect.Parameter.KEYWORD_ONLY


Document = dict[str, Any]

MOST_NAMES = 12  # of parameters in a line
Points = Sequence[tuple[float, float]]

WIDTH, HEIGHT = 60, 20
ASPECT = 2.0  # a character is twice as high as wide
MOST_AXES, LINES_OF_CHECK = 12, 20  # of the table; of the messages and the table's rows
AXIS_COLUMNS = ("", "joint", "kind", "axis", "through mm", "to the one before", "limits")
VIEWS = (("from the side: x to the right, z up", 0, 2), ("from above: x to the right, y up", 0, 1))


def show_check(document: Document, details: bool = True) -> None:
    """Print what looks wrong with a robot, and its axes; with ``details`` how it stands at zero too, drawn."""
    axes = [_axis(k, axis, document["joints"]) for k, axis in enumerate(document["axes"], 1)]
    suspicious: list[str] = document["suspicious"]
    count = len(suspicious)
    found = "1 thing looks wrong" if count == 1 else f"{count} things look wrong" if count else "nothing looks wrong"
    print_line(f"{document['name']}: {len(axes)} axes, reach {document['reach_mm']:.0f} mm; {found}.")
    messages = [f"suspicious: {word}" for word in suspicious]
    messages += [f"drive: {word}" for word in document.get("drives") or ()]
    messages += [f"note: {word}" for word in document["notes"]]
    if details:
        for message in messages:
            print_line(message)
        _draw_at_zero(document)
        show_rows(AXIS_COLUMNS, axes)
        return
    shown = min(len(axes), MOST_AXES)
    for line in fit_messages(messages, screen_columns(), LINES_OF_CHECK - shown):
        print_line(line)
    show_rows(("", "joint", "kind", "axis", "limits"), [(*axis[:4], axis[-1]) for axis in axes[:shown]])
    if shown < len(axes):
        print_line(f"and {len(axes) - shown} more axes {DETAILS}")


def _draw_at_zero(document: Document) -> None:
    print_line(f"\n{document['name']} at zero, o base, 1 2 3 ... axes, * flange, T tool")
    for title, across, up in VIEWS:
        print_line(f"\n{title}")
        print_line(drawing([(p[across], p[up]) for p in document["zero"]["points_mm"]]))
    tool = document["zero"]["tool"]
    print_line(f"\ntool at zero: {', '.join(f'{name} {value:g}' for name, value in tool.items())}")
    print_line(f"reach of the tool from the first axis: {document['reach_mm']:.0f} mm\n")


def _axis(number: int, axis: Document, joints: Sequence[Document]) -> tuple[str, ...]:
    joint = next(j for j in joints if j["name"] == axis["joint"])
    unit = "deg" if joint.get("limits_deg") else "mm"
    low, high = joint.get(f"limits_{unit}") or (None, None)
    limits = "none" if low is None or high is None else f"{low:g} to {high:g} {unit}"
    angle = axis["angle_to_previous_deg"]
    return (
        str(number),
        _driven(axis),
        axis["kind"],
        " ".join(f"{v:.3g}" for v in axis["direction"]),
        " ".join(f"{v:.1f}" for v in axis["point_mm"]),
        "" if angle is None else f"{angle:g} deg, {axis['distance_to_previous_mm']:.1f} mm",
        limits,
    )


def _driven(axis: Document) -> str:
    """What moves an axis: its joint, with the ratio and the drive where it follows one."""
    moved = axis["joint"] if axis["ratio"] == 1 else f"{axis['joint']} x {axis['ratio']:g}"
    return f"{moved} ({axis['drive']})" if axis.get("drive") else moved


def drawing(points: Points) -> str:
    """Draw the polyline through the points: base, axes, flange, tool."""
    canvas = [[" "] * WIDTH for _ in range(HEIGHT)]
    cells = _cells(points)
    for (x0, y0), (x1, y1) in itertools.pairwise(cells):
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for k in range(steps + 1):
            canvas[round(y0 + (y1 - y0) * k / steps)][round(x0 + (x1 - x0) * k / steps)] = "."
    # The base and the tool are drawn last: where marks fall together they matter most.
    marks = ["o", *(str(k % 10) for k in range(1, len(cells) - 2)), "*", "T"]
    for (x, y), mark in [*zip(cells[1:], marks[1:], strict=True), (cells[0], "o")]:
        canvas[y][x] = mark
    return "\n".join("".join(row).rstrip() for row in reversed(canvas)).strip("\n")


def _cells(points: Points) -> list[tuple[int, int]]:
    """Columns and rows of the points, the same scale both ways."""
    low_x, low_y = (min(p[k] for p in points) for k in (0, 1))
    span_x, span_y = (max(p[k] for p in points) - low for k, low in ((0, low_x), (1, low_y)))
    scale = min((WIDTH - 1) / max(span_x, 1e-9), ASPECT * (HEIGHT - 1) / max(span_y, 1e-9))
    return [(round((x - low_x) * scale), round((y - low_y) * scale / ASPECT)) for x, y in points]


class Compensation(StrEnum):
    """How a controller corrects by itself."""

    none = "none"
    factory = "factory"
    kilter = "kilter"
    unknown = "unknown"


robot = typer.Typer(help="Describe robots.", no_args_is_help=True, rich_markup_mode=None, cls=Group)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    circles.register(robot)
    keeping.register_robot(robot)
    app.add_typer(robot, name="robot")


@robot.command(epilog="Example: kilter robot add robot.json")
@takes_a_robot
def add(
    source: RobotSource,
    controller_compensation: Annotated[
        Compensation | None,
        typer.Option(
            help="Whether the controller corrects the arm by itself; unknown where neither this nor FILE says."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Add a robot from robot.json, another tool's file, or a preset."""
    document = source.document()
    if controller_compensation is not None:
        document = {**document, "controller_compensation": controller_compensation.value}
    with Kilter() as kilter:
        added = kilter.robots.add(document)
        emit(added, as_json, partial(_show, kilter.url))
        if not as_json:
            print_lines(f"suspicious: {line}" for line in kilter.robots.check(document)["suspicious"])
            print_lines(format_next("upload", added["name"], PLACEHOLDER))


@robot.command(epilog="Example: kilter robot check arm.csv --name arm --convention dh --plot arm.png")
@takes_a_robot
def check(
    source: RobotSource,
    plot: Annotated[Path | None, typer.Option(help="Draw the arm into this .png or .svg file too.")] = None,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Check a robot: what looks wrong, reach, axes, limits; --details draws it at zero. Nothing is added."""
    if plot is not None and plot.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--plot {plot}: give a file that ends in .png or .svg.")
    document = source.document(source.file.stem if source.file else None)
    with Kilter() as kilter:
        found = kilter.robots.check(document)
    if plot is not None:
        save_arm(plot, found)
    emit(found, as_json, partial(show_check, details=details))
    if not as_json:
        named = [] if source.described.name or source.preset else ["--name", document["name"]]
        when = ", if that is right" if found["suspicious"] else ""
        print_lines(format_next("robot", "add", *source.words, *named, when=when))


@robot.command(epilog="Example: kilter robot convert arm.csv --name arm --convention dh --to mcpc -o arm.json")
@takes_a_robot
def convert(
    source: RobotSource,
    to: Annotated[str, typer.Option(metavar="CONVENTION", help="chain, dh, mdh, s_model, poe, cpc, mcpc or urdf.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="File to write, .json or .urdf; without it the document is printed."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a robot in another convention: the same poses at the same joint readings; nothing is added."""
    document = source.document(source.file.stem if source.file and source.file.suffix != ".json" else None)
    with Kilter() as kilter:
        found = kilter.robots.convert(document, to)
    if output is not None:
        text = found["urdf"] if output.suffix == ".urdf" and to == "urdf" else json.dumps(found, indent=1) + "\n"
        write(output, text.encode())
        note(f"{output}: {to}", as_json)
        found = {**found, "file": str(output)} if as_json else found
    emit(found, as_json, say_document if output is None else lambda _: None)


@robot.command(epilog="Example: kilter robot compensation ur10 none")
def compensation(
    robot: Robot,
    compensation: Annotated[
        Compensation, typer.Argument(metavar="none|factory|kilter|unknown", help="How it corrects.", show_default=False)
    ],
    as_json: Json = False,
) -> None:
    """Say whether the controller corrects the arm by itself.

    Nothing is then corrected twice. none; factory: by its maker's calibration; kilter: by a calibration that Kilter exported.
    """
    with Kilter() as kilter:
        emit(
            kilter.robots.compensation(robot, compensation.value),
            as_json,
            lambda found: print_line(found["controller_sentence"]),
        )


@robot.command(epilog="Example: kilter robot tolerance ur10 0.3 --check-every 30")
def tolerance(
    robot: Robot,
    tolerance_mm: Annotated[
        float | None, typer.Argument(metavar="[MM]", help="Largest mean error that is good enough; none: not stated.")
    ] = None,
    check_every: Annotated[
        int | None, typer.Option(metavar="DAYS", help="Days within which it is to be checked; left out: not stated.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say how good a robot must be, and how often it is checked; `kilter today` then says whether it is."""
    with Kilter() as kilter:
        emit(
            kilter.robots.tolerance(robot, tolerance_mm, check_every), as_json, lambda found: print_line(_goals(found))
        )


def _goals(found: dict[str, Any]) -> str:
    limit, days = found["tolerance_mm"], found["check_interval_days"]
    said = [f"tolerance {limit:g} mm" if limit is not None else "no tolerance"]
    return ", ".join([*said, f"checked every {days} days" if days is not None else "no interval of checks"])


@robot.command("list", epilog="Example: kilter robot list")
def list_(retired: Retired = False, as_json: Json = False) -> None:
    """List the robots."""
    with Kilter() as kilter:
        document = {"robots": kilter.robots.list(retired)}
    emit(document, as_json, _show_list)


@robot.command(epilog="Example: kilter robot show katana450")
def show(robot: Robot, as_json: Json = False) -> None:
    """Show a robot: joints, limits, and the names of its parameters."""
    with Kilter() as kilter:
        emit(kilter.robots.get(robot), as_json, partial(_show, kilter.url))


def say_document(document: dict[str, Any]) -> None:
    """Print a robot document as it would stand in its file."""
    print_line(json.dumps(document, indent=1))


def _show(server: str, document: dict[str, Any]) -> None:
    print_line(
        f"{document['name']} ({document['convention']}), active version: {document.get('active_version') or 'none'}"
    )
    rows = [
        (
            str(number),
            joint["name"],
            joint["kind"],
            _limits(joint),
            "" if joint.get("gear_ratio") is None else f"{joint['gear_ratio']:g}",
        )
        for number, joint in enumerate(document.get("joints", ()), 1)
    ]
    show_rows(("", "joint", "kind", "limits", "gear ratio"), rows)
    known = document.get("controller_compensation", "unknown") != "unknown"
    if known or is_note_due(server, document["controller_sentence"]):
        print_line(document["controller_sentence"])
    else:
        print_line("controller: unknown (`kilter robot compensation` says what it does)")
    if document["tolerance_mm"] is not None or document["check_interval_days"] is not None:
        print_line(_goals(document))
    names = list(document.get("parameters", ()))
    more = f" and {len(names) - MOST_NAMES} more (--json)" if len(names) > MOST_NAMES else ""
    print_line(f"{len(names)} parameters: {', '.join(names[:MOST_NAMES]) or 'none'}{more}")
    load = (document.get("document") or {}).get("load")
    if load:
        centre = ", ".join(f"{value:g}" for value in load.get("payload_com_mm") or (0, 0, 0))
        print_line(f"default load: {load['payload_kg']:g} kg at ({centre}) mm in the tool frame")
    if document.get("remarks"):
        print_line(f"remarks: {document['remarks']}")
    for remark in document.get("notes", ()):
        print_line(f"note: {remark}")


def _limits(joint: dict[str, Any]) -> str:
    unit = "deg" if joint.get("limits_deg") else "mm"
    low, high = joint.get(f"limits_{unit}") or (None, None)
    if low is None and high is None:
        return "none"
    return f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'} {unit}"


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (
            r["name"] + (" (retired)" if r.get("retired_at") else ""),
            r["convention"],
            str(r["campaigns"]),
            str(r["versions"]),
            r.get("active_version") or "none",
            r.get("controller_compensation") or "unknown",
        )
        for r in document["robots"]
    ]
    show_list(("robot", "convention", "campaigns", "versions", "active", "controller"), rows)
