"""``kilter filter``: the targets of a robot program corrected, all else byte for byte."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.reports.answer import IN_JSON
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, note, print_line
from kilter_client.errors import UsageError
from kilter_client.files import files_formats

if TYPE_CHECKING:
    from kilter_client.results.corrected import FilteredProgram

MOST_LINES = 6  # lines of a program that are named


class ThirdJoint(StrEnum):
    """What the J3 of a FANUC program is to the robot."""

    SAME = "same"
    COUPLED = "coupled"


Base = Annotated[
    list[str] | None,
    typer.Option(
        help="Frame that the program uses and does not hold: NAME=NUMBERS, its number (or name) and the numbers that "
        "the program would give, as 2=500,0,300,0,0,0; NUMBERS alone where none has a name. More than once."
    ),
]
Tool = Annotated[list[str] | None, typer.Option(help="Tool, in the same way: 1=0,0,120.5,0,0,0.")]
Track = Annotated[
    list[str] | None,
    typer.Option(
        help="External axis that carries the arm: NAME=AXIS, the direction in the frame of the arm's root, as eax_a=x or "
        "E1=-y,1000 (mm for each unit of the program); E2=none: it moves no frame in use. More than once."
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command("filter", epilog="Example: kilter filter weld.mod --robot irb -o weld_corrected.mod --diff")(
        filter_program
    )


def filter_program(
    program: Annotated[
        Path,
        typer.Argument(help="The program: .src, .dat, .mod, .modx, .script, .ls or .csv.", exists=True, dir_okay=False),
    ],
    robot: Annotated[str, typer.Option("--robot", help="Name of the robot.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write.")] = None,
    version: Annotated[
        str | None, typer.Option(help="Version to correct with: id, name, or `latest`; default: the active one.")
    ] = None,
    signs: Annotated[
        str | None,
        typer.Option(help="Signs of the program's joints against the robot's, as +,-,+,+,-,+; default: all +."),
    ] = None,
    fanuc_j3: Annotated[
        ThirdJoint | None,
        typer.Option(help="FANUC: J3 of the program is the robot's (same), or the robot's is J2 + J3 (coupled)."),
    ] = None,
    base: Base = None,
    tool: Tool = None,
    track: Track = None,
    diff: Annotated[bool, typer.Option("--diff", help="Print the changed lines.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Write nothing unless every target is rewritten and its status is OK.")
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Correct a program that was corrected: its targets were taught anew since.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="The output may be the program itself.")] = False,
    as_json: Json = False,
) -> None:
    """Correct the targets of a robot program: KRL, RAPID, URScript, FANUC LS or CSV.

    A KRL program is read with its other file (.src or .dat) where that stands beside it; both are corrected, and the other is
    written beside --output.
    Poses are rewritten where frame, tool and configuration are known; others are named and left, or refused with --strict.
    Comments, speeds, logic, white space, line ends and external axes stay as they are. A comment, in a table a column, says
    which version corrected the program; a program that says so is refused.
    """
    _refuse_output(program, output, diff, overwrite)
    with Kilter() as kilter:
        done = kilter.filter(
            robot,
            program,
            version=version,
            signs=signs,
            fanuc_j3=fanuc_j3 and fanuc_j3.value,
            bases=_frames_by_name(base),
            tools=_frames_by_name(tool),
            tracks=_frames_by_name(track),
            strict=strict,
            again=again,
        )
    if output is not None:
        done.save(output)
    document = {key: value for key, value in done.document.items() if key != "texts"}
    document |= {"robot": robot, "output": output and str(output), "diff": done.diff if diff else None}
    document["written"] = [str(path) for path in done.paths(output)] if output is not None else []
    _note(done, as_json)
    emit(document, as_json, _show)


def _refuse_output(program: Path, output: Path | None, diff: bool, overwrite: bool) -> None:
    """Refuse to write nowhere or over the program; before that a program of an unknown dialect, which no output helps."""
    files_formats.dialect_of_file(program)
    if output is None and not diff:
        raise UsageError("Name the file to write with -o, or ask for --diff.")
    if output is not None and output.resolve() == program.resolve() and not overwrite:
        raise UsageError(f"{output} is the program itself: name another file, or say --overwrite.")


def _note(done: FilteredProgram, as_json: bool) -> None:
    several = len(done.texts) > 1
    for line in done.left[:MOST_LINES]:
        place = f"{line['file']}, line {line['line']}" if several else f"line {line['line']}"
        note(f"Warning: {place} is left as it is: {line['what']}.", as_json)
    if len(done.left) > MOST_LINES:
        note(f"{len(done.left) - MOST_LINES} more lines are left as they are {IN_JSON}", as_json)
    for remedy in files_formats.remedies(str(line["what"]) for line in done.left):
        note(f"What helps: {remedy}", as_json)
    for remark in done.notes:
        note(f"Note: {remark}", as_json)


def _frames_by_name(given: list[str] | None) -> dict[str, str]:
    """Frames by their names; one without a name has an empty one."""
    parted = [one.rpartition("=") for one in given or []]
    return {name.strip(): numbers for name, _, numbers in parted}


def _show(document: dict[str, Any]) -> None:
    if document["diff"]:
        print_line(document["diff"])
    worst = f"{document['largest_change_file']}, line {document['largest_change_line']}"
    change = f"{document['largest_change_deg']:.3g} deg ({worst})"
    written = " and ".join(document["written"]) or "Nothing written"
    print_line(f"{written}: {document['targets']} targets, largest change {change}")
    for held in document["not_ok"][:MOST_LINES]:
        about = f": {held['at_limits']}" if held["at_limits"] else ""
        print_line(f"  {held['file']}, line {held['line']}: {held['name']} is {held['status']}{about}")
    if len(document["not_ok"]) > MOST_LINES:
        print_line(f"  and {len(document['not_ok']) - MOST_LINES} more {IN_JSON}")
