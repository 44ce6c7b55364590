"""Robot programs with their joint targets corrected, all else byte for byte."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.calls import robots
from kilter_client.errors import FileError, UsageError
from kilter_client.given import signs_of
from kilter_client.steps import Document, Steps
from kilter_client.verbs.things import Thing, reference
from kilter_client.verbs.versions import correct

if TYPE_CHECKING:
    from kilter_client.results.program import FilteredProgram
    from kilter_files.formats.programs.found import JointTarget, Program

    Place = tuple[Program, JointTarget]

ANSWERED = frozenset({"OK", "DAMPED", "LIMITED"})  # targets that have numbers
FANUC_J3 = ("same", "coupled")
SHOWN = 20


def filter(  # noqa: A001 - a verb, as the command is called
    robot: Thing,
    program: str | PathLike[str],
    *,
    version: Thing | None = None,
    signs: Sequence[float] | str | None = None,
    fanuc_j3: str | None = None,
    strict: bool = False,
) -> Steps[FilteredProgram]:
    """Correct the joint targets of a robot program: KRL, RAPID, URScript, FANUC LS or CSV; nothing is written.

    A KRL program is read with its other file (.src or .dat) where that stands beside it, and both are corrected.
    Cartesian targets are not rewritten: ``left`` names them with their lines. Comments, speeds, logic, white space, line
    ends and external axes stay as they are.

    Args:
        robot: name of the robot.
        program: path of the program: .src, .dat, .mod, .script, .ls or .csv.
        version: another version than the active one: id or its beginning, name, or ``"latest"``.
        signs: signs of the program's joints against the robot's: ``(1, -1, 1, 1, -1, 1)`` or ``"+,-,+,+,-,+"``.
        fanuc_j3: ``"same"`` where J3 of a FANUC program is the robot's, ``"coupled"`` where the robot's is J2 + J3.
        strict: refuse the program unless every target is rewritten and its status is OK.

    Raises:
        FileError: it is not such a program, a target cannot be corrected, or ``strict``, and a line is left.
        UsageError: signs or FANUC's J3 are not stated as they should be.
        ConflictError: the robot has no active version.

    """
    from kilter_client.results.program import FilteredProgram
    from kilter_files.formats.programs.reading import read_programs, visited

    programs = read_programs(Path(fspath(program)))
    places = visited(programs)
    coupled = _coupled(programs[0], fanuc_j3)
    if strict:
        _refuse([(one, line, what) for one in programs for line, what in one.left], programs, "is not rewritten")
    directions = signs_of(signs, len(places[0][1].joints_deg), "program")
    name = reference("robot", robot)
    yield from _refuse_other_robot(places[0], name)
    joints, status, notes = yield from _corrected(places, name, version, directions, coupled)
    wanted = {"OK"} if strict else ANSWERED
    wrong = [(one, t.line, f"{t.name}: {s}") for (one, t), s in zip(places, status, strict=True) if s not in wanted]
    _refuse(wrong, programs, "is not corrected")
    row = {id(target): q for (_, target), q in zip(places, joints, strict=True)}
    texts = {one.path.name: one.rewritten([row[id(target)] for target in one.targets]) for one in programs}
    diffs = [_diff(one, texts[one.path.name]) for one in programs]
    told = {"texts": texts, "notes": list(notes), "diff": "\n".join(diff for diff in diffs if diff)}
    return FilteredProgram.read(_report(programs, places, joints, status) | told)


def _coupled(found: Program, fanuc_j3: str | None) -> bool:
    if fanuc_j3 not in (None, *FANUC_J3):
        raise UsageError(f"--fanuc-j3 {fanuc_j3}: give one of {', '.join(FANUC_J3)}.")
    if found.dialect == "FANUC LS" and fanuc_j3 is None:
        raise UsageError("State what J3 of the program is to the robot: --fanuc-j3 same or --fanuc-j3 coupled.")
    return fanuc_j3 == "coupled" and found.dialect == "FANUC LS"


def _refuse_other_robot(place: Place, robot: str) -> Steps[None]:
    expected = len((yield from robots.one(robot))["joints"])
    program, target = place
    if expected != len(target.joints_deg):
        what = f"{target.name} has {len(target.joints_deg)} joints, {robot} has {expected}"
        said = f"{program.path}, line {target.line}: {what}. Name the robot of this program."
        raise FileError(said, file=str(program.path), line=target.line)


def _corrected(
    places: Sequence[Place], robot: str, version: Thing | None, signs: Sequence[float], coupled: bool
) -> Steps[tuple[list[list[float]], list[str], tuple[str, ...]]]:
    """Correct all targets in one call: joints of the program in deg, a status for each, and what the server says of it."""
    rows = [[*target.joints_deg] for _, target in places]
    if coupled:
        rows = [[*q[:2], q[2] + q[1], *q[3:]] for q in rows]
    names = [f"q{k}_deg" for k in range(1, len(signs) + 1)]
    columns = {name: [signs[k] * q[k] for q in rows] for k, name in enumerate(names)}
    content = yield from correct(robot, columns, version=version)
    answer = content.rows.to_dict()
    status = [str(word) for word in answer["status"]]
    joints = [
        [signs[k] * float(answer[name][row]) if word in ANSWERED else float("nan") for k, name in enumerate(names)]
        for row, word in enumerate(status)
    ]
    return [[*q[:2], q[2] - q[1], *q[3:]] if coupled else q for q in joints], status, content.notes


def _refuse(places: Sequence[tuple[Program, int, str]], programs: Sequence[Program], what: str) -> None:
    """Refuse a program for these places.

    Raises:
        FileError: there is one.

    """
    if places:
        several = len(programs) > 1
        named = "; ".join(
            f"{f'{one.path.name}, ' if several else ''}line {line}: {said}" for one, line, said in places[:SHOWN]
        )
        more = f" and {len(places) - SHOWN} more" if len(places) > SHOWN else ""
        remedy = (
            "Nothing is written. Store these targets as joints within reach, or leave --strict out where it was given."
        )
        path = programs[0].path
        at = [{"file": str(one.path), "line": line} for one, line, _ in places]
        context = {"places": at} if several else {"lines": [line for _, line, _ in places]}
        raise FileError(f"{path}: {what}: {named}{more}. {remedy}", file=str(path), **context)


def _report(
    programs: Sequence[Program], places: Sequence[Place], joints: Sequence[Sequence[float]], status: Sequence[str]
) -> Document:
    changes = [_change(target, q) for (_, target), q in zip(places, joints, strict=True)]
    worst, target = places[max(range(len(changes)), key=changes.__getitem__)]
    held: list[dict[str, Any]] = [
        {"file": program.path.name, "line": target.line, "name": target.name, "status": word}
        for (program, target), word in zip(places, status, strict=True)
        if word != "OK"
    ]
    return {
        "dialect": programs[0].dialect,
        "targets": len(places),
        "largest_change_deg": max(changes),
        "largest_change_file": worst.path.name,
        "largest_change_line": target.line,
        "not_ok": held,
        "left": [{"file": one.path.name, "line": line, "what": what} for one in programs for line, what in one.left],
    }


def _change(target: JointTarget, joints: Sequence[float]) -> float:
    return max(abs(new - old) for new, old in zip(joints, target.joints_deg, strict=True))


def _diff(program: Program, new: str) -> str:
    old = program.text.split("\n")
    lines = difflib.unified_diff(old, new.split("\n"), str(program.path), "corrected", lineterm="", n=1)
    return "\n".join(line.rstrip("\r") for line in lines)
