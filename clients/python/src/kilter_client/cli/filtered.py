"""``kilter filter``: the joint targets of a robot program corrected, all else byte for byte."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.arguments import Json
from kilter_client.cli.correct import ANSWERED
from kilter_client.cli.output import emit, note, say
from kilter_client.cli.versions import write
from kilter_client.errors import FileError, UsageError
from kilter_files.formats.programs.found import JointTarget, Program
from kilter_files.formats.programs.reading import read_program

SHOWN = 20


class ThirdJoint(StrEnum):
    """What the J3 of a FANUC program is to the robot."""

    SAME = "same"
    COUPLED = "coupled"


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command("filter", epilog="Example: kilter filter weld.mod --robot irb -o weld_corrected.mod --diff")(filtered)


def filtered(
    program: Annotated[
        Path, typer.Argument(help="The program: .src, .dat, .mod, .script, .ls or .csv.", exists=True, dir_okay=False)
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
    diff: Annotated[bool, typer.Option("--diff", help="Print the changed lines.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Write nothing unless every target is rewritten and its status is OK.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="The output may be the program itself.")] = False,
    as_json: Json = False,
) -> None:
    """Correct the joint targets of a robot program: KRL, RAPID, URScript, FANUC LS or CSV.

    Cartesian targets are not rewritten: they are named with their lines and left, or refused with --strict.
    Comments, speeds, logic, white space, line ends and external axes stay as they are.
    """
    if output is None and not diff:
        raise UsageError("Name the file to write with -o, or ask for --diff.")
    if output is not None and output.resolve() == program.resolve() and not overwrite:
        raise UsageError(f"{output} is the program itself: name another file, or say --overwrite.")
    found = read_program(program)
    if found.dialect == "FANUC LS" and fanuc_j3 is None:
        raise UsageError("State what J3 of the program is to the robot: --fanuc-j3 same or --fanuc-j3 coupled.")
    coupled = fanuc_j3 is ThirdJoint.COUPLED and found.dialect == "FANUC LS"
    _refuse(found, [(line, what) for line, what in found.left] if strict else [], "is not rewritten")
    directions = _signs(signs, len(found.targets[0].joints_deg))
    joints, status, notes = _corrected(found, robot, version, directions, coupled)
    wrong = [(t, s) for t, s in zip(found.targets, status, strict=True) if s not in ({"OK"} if strict else ANSWERED)]
    _refuse(found, [(target.line, f"{target.name}: {word}") for target, word in wrong], "is not corrected")
    text = found.rewritten(joints)
    if output is not None:
        write(output, text.encode("latin-1"))
    document = _document(found, joints, status) | {"robot": robot, "output": output and str(output)}
    document["notes"] = list(notes)
    document["diff"] = _diff(found.text, text, program) if diff else None
    for line, what in found.left:
        note(f"Warning: line {line} is left as it is: {what}.", as_json)
    for remark in notes:
        note(f"Note: {remark}", as_json)
    emit(document, as_json, _show)


def _signs(text: str | None, count: int) -> list[float]:
    given = ["+"] * count if text is None else [part.strip() for part in text.split(",")]
    if len(given) != count or set(given) - {"+", "-"}:
        raise UsageError(f"--signs {text}: give + or - for each of the {count} joints of the program.")
    return [-1.0 if sign == "-" else 1.0 for sign in given]


def _corrected(
    found: Program, robot: str, version: str | None, signs: Sequence[float], coupled: bool
) -> tuple[list[list[float]], list[str], tuple[str, ...]]:
    """Correct all targets in one call: joints of the program in deg, a status for each, and what the server says of it."""
    rows = [[*target.joints_deg] for target in found.targets]
    if coupled:
        rows = [[*q[:2], q[2] + q[1], *q[3:]] for q in rows]
    names = [f"q{k}_deg" for k in range(1, len(signs) + 1)]
    columns = {name: [signs[k] * q[k] for q in rows] for k, name in enumerate(names)}
    with Kilter() as kilter:
        expected = len(kilter.robots.get(robot)["joints"])
        if expected != len(signs):
            target = found.targets[0]
            what = f"{target.name} has {len(signs)} joints, {robot} has {expected}"
            raise FileError(
                f"{found.path}, line {target.line}: {what}. Name the robot of this program.", line=target.line
            )
        content = kilter.correct(robot, columns, version=version)
    answer = content.rows.to_dict()
    status = [str(word) for word in answer["status"]]
    joints = [
        [signs[k] * float(answer[name][row]) if word in ANSWERED else float("nan") for k, name in enumerate(names)]
        for row, word in enumerate(status)
    ]
    return [[*q[:2], q[2] - q[1], *q[3:]] if coupled else q for q in joints], status, content.notes


def _refuse(found: Program, places: Sequence[tuple[int, str]], what: str) -> None:
    """Refuse a program for these places.

    Raises:
        FileError: there is one.

    """
    if places:
        named = "; ".join(f"line {line}: {said}" for line, said in places[:SHOWN])
        more = f" and {len(places) - SHOWN} more" if len(places) > SHOWN else ""
        remedy = (
            "Nothing is written. Store these targets as joints within reach, or leave --strict out where it was given."
        )
        lines = [line for line, _ in places]
        raise FileError(f"{found.path}: {what}: {named}{more}. {remedy}", file=str(found.path), lines=lines)


def _document(found: Program, joints: Sequence[Sequence[float]], status: Sequence[str]) -> dict[str, Any]:
    changes = [_change(target, q) for target, q in zip(found.targets, joints, strict=True)]
    worst = max(range(len(changes)), key=changes.__getitem__)
    held = [
        {"line": target.line, "name": target.name, "status": word}
        for target, word in zip(found.targets, status, strict=True)
        if word != "OK"
    ]
    return {
        "dialect": found.dialect,
        "targets": len(found.targets),
        "largest_change_deg": changes[worst],
        "largest_change_line": found.targets[worst].line,
        "not_ok": held,
        "left": [{"line": line, "what": what} for line, what in found.left],
    }


def _change(target: JointTarget, joints: Sequence[float]) -> float:
    return max(abs(new - old) for new, old in zip(joints, target.joints_deg, strict=True))


def _diff(old: str, new: str, path: Path) -> str:
    lines = difflib.unified_diff(old.split("\n"), new.split("\n"), str(path), "corrected", lineterm="", n=1)
    return "\n".join(line.rstrip("\r") for line in lines)


def _show(document: dict[str, Any]) -> None:
    if document["diff"]:
        say(document["diff"])
    change = f"{document['largest_change_deg']:.3g} deg (line {document['largest_change_line']})"
    say(f"{document['output'] or 'Nothing written'}: {document['targets']} targets, largest change {change}")
    for held in document["not_ok"]:
        say(f"  line {held['line']}: {held['name']} is {held['status']}")
