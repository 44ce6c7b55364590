"""Robot programs with their targets corrected, all else byte for byte."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

from kilter_client.errors import FileError, UsageError
from kilter_client.files import files_formats
from kilter_client.requests.calls import robots, versions
from kilter_client.requests.steps import Document, Steps
from kilter_client.results.corrected import FilteredProgram
from kilter_client.verbs.inputs import ResourceReference, parse_signs, reference
from kilter_client.verbs.program_poses import ProgramJoints, Understood, not_kept, rewritten, understand
from kilter_client.verbs.versions import correct

if TYPE_CHECKING:
    from kilter_client.results.corrected import FilteredProgram
    from kilter_files.formats import JointTarget, PoseTarget, Program, Stated, Track

AT_LIMIT_DEG = 1e-6  # what is held stands at the limit, but for the last digits


def at_limits(robot: Document, taught_deg: Sequence[float], new_deg: Sequence[float]) -> str:
    """Name each joint with its angle and the limit, by the robot's joints; empty: none is at one.

    ``taught_deg`` are the joints of the target, ``new_deg`` the corrected ones, NaN where it was refused.
    """
    said = []
    for k, (joint, taught, new) in enumerate(zip(robot["joints"], taught_deg, new_deg, strict=True), 1):
        name = joint.get("name") or f"joint {k}"
        lower, upper = joint.get("limits_deg") or (None, None)
        for limit, side in ((lower, -1.0), (upper, 1.0)):
            if limit is None:
                continue
            if side * (taught - limit) > 0.0:
                said.append(f"{name} at {taught:.6g} deg is beyond its limit of {limit:g} deg")
            elif side * (new - limit) > -AT_LIMIT_DEG:
                said.append(f"{name} at {taught:.6g} deg is held at its limit of {limit:g} deg")
    return ", ".join(said)


Frames: TypeAlias = "Mapping[str, Sequence[float] | str] | Sequence[float] | str"

ANSWERED = frozenset({"OK", "DAMPED", "LIMITED", "UNSURE"})  # targets that have numbers
FANUC_J3 = ("same", "coupled")
SHOWN = 20


def filter(  # noqa: A001 - a verb, as the command is called
    robot: ResourceReference,
    program: str | PathLike[str],
    *,
    version: ResourceReference | None = None,
    signs: Sequence[float] | str | None = None,
    fanuc_j3: str | None = None,
    bases: Frames | None = None,
    tools: Frames | None = None,
    tracks: Mapping[str, str] | None = None,
    strict: bool = False,
    again: bool = False,
) -> Steps[FilteredProgram]:
    """Correct the targets of a robot program: KRL, RAPID, URScript, FANUC LS or CSV; nothing is written.

    A KRL program is read with its other file (.src or .dat) where that stands beside it, and both are corrected.
    A pose is rewritten where frame, tool and configuration are known, so that the controller's own nominal kinematics
    gives the corrected joints there; ``left`` names all others with their lines. Comments, speeds, logic, white space,
    line ends and external axes stay as they are. A comment, in a table a column, says which version corrected it.

    Args:
        robot: name of the robot.
        program: path of the program: .src, .dat, .mod, .modx, .script, .ls or .csv.
        version: another version than the active one: id or its beginning, name, or ``"latest"``.
        signs: signs of the program's joints against the robot's: ``(1, -1, 1, 1, -1, 1)`` or ``"+,-,+,+,-,+"``.
        fanuc_j3: ``"same"`` where J3 of a FANUC program is the robot's, ``"coupled"`` where the robot's is J2 + J3.
        bases: frames that the program uses and does not hold, in its own numbers: ``{"2": (500, 0, 300, 0, 0, 0)}``, or one.
        tools: tools, in the same way.
        tracks: external axes that carry the arm: ``{"eax_a": "x"}``, ``"-y,1000"`` (mm a unit), ``"none"``: it carries nothing.
        strict: refuse the program unless every target is rewritten and its status is OK.
        again: correct a program that says that it was corrected: its targets were taught anew since.

    Raises:
        FileError: it is not such a program, or was corrected already, a target cannot be corrected, or ``strict``, and a
            line is left.
        UsageError: signs, FANUC's J3, frames or tools are not stated as they should be.
        ConflictError: the robot has no active version.

    """
    programs = _programs(program, _stated_frames(bases, tools, tracks), again)
    coupled = _is_j3_coupled(programs[0], fanuc_j3)
    name = reference("robot", robot)
    document = yield from robots.fetch_document(name)
    version_id = yield from _version_id(document, version)
    first = next(((one, target) for one in programs for target in one.targets), None)
    count = len(first[1].joints_deg) if first is not None else len(document["joints"])
    joints = ProgramJoints(parse_signs(signs, count, "program"), coupled)
    if first is not None:
        _refuse_other_robot(*first, document)
    understood = yield from understand(programs, document, joints)
    _name_left(programs, understood)
    if strict:
        _refuse(_skipped_targets(programs), programs, "is not rewritten", strict=True, suspicion=understood.suspicion)
    done = yield from _correct_targets(programs, understood, joints, document, version_id)
    wanted = {"OK"} if strict else ANSWERED
    wrong = [(d.program, d.target.line, f"{d.target.name}: {d.status_text}") for d in done if d.status not in wanted]
    _refuse(wrong, programs, "is not corrected", strict=strict)
    done = yield from _drop_unreachable_poses(programs, done, understood, joints, name, strict=strict)
    texts = yield from _texts(programs, done, joints, name, version_id)
    return FilteredProgram.read(_report(programs, done, texts))


def _stated_frames(bases: Frames | None, tools: Frames | None, tracks: Mapping[str, str] | None) -> Stated:
    return files_formats.Stated(_frames(bases, "base"), _frames(tools, "tool"), _tracks(tracks or {}))


def _tracks(given: Mapping[str, str]) -> dict[str, Track]:
    """Read external axes that carry the arm."""
    out = {}
    for name, said in given.items():
        track = files_formats.parse_track(said)
        if track is None or not name:
            raise UsageError(
                f"--track {name}={said}: give a direction of the arm's root, as --track eax_a=x or E1=-y,1000."
            )
        out[name.lower()] = track
    return out


def _programs(path: str | PathLike[str], stated: Stated, again: bool) -> list[Program]:
    programs = files_formats.read_programs(Path(fspath(path)), stated)
    if not again:
        files_formats.refuse_corrected(programs)
    _refuse_other_numbers(stated, programs[0].dialect)
    return programs


def _name_left(programs: Sequence[Program], understood: Understood) -> None:
    for one in programs:
        one.leave_poses(understood.left)
    if understood.suspicion:
        programs[0].warn(understood.suspicion)


def _version_id(robot: Document, version: ResourceReference | None) -> Steps[str | None]:
    """Id of the version to correct with: the mark says it. None where the robot has no active one."""
    if not version:
        return str(robot["active_version"]) if robot["active_version"] else None
    found = yield from versions.fetch_document(reference("version", version), str(robot["name"]))
    return str(found["id"])


def _is_j3_coupled(found: Program, fanuc_j3: str | None) -> bool:
    if fanuc_j3 not in (None, *FANUC_J3):
        raise UsageError(f"--fanuc-j3 {fanuc_j3}: give one of {', '.join(FANUC_J3)}.")
    if found.dialect == "FANUC LS" and fanuc_j3 is None:
        raise UsageError("State what J3 of the program is to the robot: --fanuc-j3 same or --fanuc-j3 coupled.")
    return fanuc_j3 == "coupled" and found.dialect == "FANUC LS"


def _frames(given: Frames | None, option: str) -> dict[str, tuple[float, ...]]:
    """Read frames as they are stated: by name, or one alone, each as numbers or as a text of numbers."""
    if given is None:
        return {}
    named = given if isinstance(given, Mapping) else {"": given}
    out = {}
    for name, numbers in named.items():
        try:
            out[str(name)] = tuple(
                float(part) for part in (numbers.split(",") if isinstance(numbers, str) else numbers)
            )
        except ValueError:
            out[str(name)] = ()
        if len(out[str(name)]) not in (6, 7) or not all(map(math.isfinite, out[str(name)])):
            what = f"--{option} {name}{'=' if name else ''}{numbers}"
            raise UsageError(f"{what}: give the numbers that the program would, as --{option} 1=0,0,120.5,0,0,0.")
    return out


def _refuse_other_numbers(stated: Stated, dialect: str) -> None:
    count = 7 if dialect == "RAPID" else 6
    for option, frames in (("base", stated.bases), ("tool", stated.tools)):
        wrong = next((name for name, numbers in frames.items() if len(numbers) != count), None)
        if wrong is not None:
            raise UsageError(f"--{option} {wrong}: a frame of {dialect} has {count} numbers, not {len(frames[wrong])}.")


def _refuse_other_robot(program: Program, target: JointTarget, robot: Document) -> None:
    if len(robot["joints"]) != len(target.joints_deg):
        what = f"{target.name} has {len(target.joints_deg)} joints, {robot['name']} has {len(robot['joints'])}"
        said = f"{program.path}, line {target.line}: {what}. Name the robot of this program."
        raise FileError(said, file=str(program.path), line=target.line)


@dataclass(frozen=True)
class Done:
    """A target as corrected: joints of the robot in deg, as they were taught and as they are to be.

    ``at_limits``: the robot's joints that are beyond a limit or held at one, in words.
    """

    program: Program
    target: JointTarget | PoseTarget
    taught_deg: Sequence[float]
    joints_deg: Sequence[float]
    status: str
    at_limits: str

    @property
    def status_text(self) -> str:
        """The status, and what it is about."""
        return f"{self.status}, {self.at_limits}" if self.at_limits else self.status


class AllDone(list[Done]):
    """All targets as corrected, in the order in which they were, and what the server says of them."""

    notes: tuple[str, ...] = ()


def _correct_targets(
    programs: Sequence[Program], understood: Understood, joints: ProgramJoints, robot: Document, version: str | None
) -> Steps[AllDone]:
    """Correct all targets in one call."""
    places = [
        place
        for place in files_formats.targets_in_visit_order(programs)
        if place[1] not in understood.left and _has_known_joints(place[1], understood)
    ]
    rows = [
        [*understood.joints_deg[target]]
        if isinstance(target, files_formats.PoseTarget)
        else joints.of_robot(target.joints_deg)
        for _, target in places
    ]
    if not rows:
        _refuse(
            _skipped_targets(programs),
            programs,
            "has no target that can be",
            strict=False,
            suspicion=understood.suspicion,
        )
    names = [f"q{k}_deg" for k in range(1, len(joints.signs) + 1)]
    columns = {name: [q[k] for q in rows] for k, name in enumerate(names)}
    content = yield from correct(str(robot["name"]), columns, version=version)
    answer = content.rows.to_dict()
    done = AllDone()
    done.notes = content.notes
    for row, ((program, target), taught) in enumerate(zip(places, rows, strict=True)):
        status = str(answer["status"][row])
        new = [float(answer[name][row]) if status in ANSWERED else math.nan for name in names]
        held = at_limits(robot, taught, new) if status in ("JOINT_LIMIT", "LIMITED") else ""
        done.append(Done(program, target, taught, new, status, held))
    return done


def _drop_unreachable_poses(
    programs: Sequence[Program],
    done: AllDone,
    understood: Understood,
    joints: ProgramJoints,
    robot: str,
    *,
    strict: bool,
) -> Steps[AllDone]:
    """Leave the poses that would no longer be reached in their configuration, each named with its line."""
    poses = [(one.target, one.joints_deg) for one in done if _is_pose(one.target)]
    lost = yield from not_kept(robot, poses, understood, joints)
    for one in programs:
        one.leave_poses(lost)
    kept = AllDone(one for one in done if one.target not in lost)
    kept.notes = done.notes
    if lost and (strict or not kept):
        _refuse(
            _skipped_targets(programs),
            programs,
            "is not rewritten" if strict else "has no target that can be",
            strict=strict,
        )
    return kept


def _is_pose(target: JointTarget | PoseTarget) -> TypeGuard[PoseTarget]:
    return isinstance(target, files_formats.PoseTarget)


def _has_known_joints(target: JointTarget | PoseTarget, understood: Understood) -> bool:
    return not _is_pose(target) or target in understood.joints_deg


def _texts(
    programs: Sequence[Program], done: AllDone, joints: ProgramJoints, robot: str, version: str | None
) -> Steps[dict[str, str]]:
    """Write the targets into their programs, with the mark of the version: the texts by name of file."""
    poses = [(one.program, one.target, one.joints_deg) for one in done if _is_pose(one.target)]
    placed = [(program, target) for program, target, _ in poses]
    edits = yield from rewritten(robot, placed, [q for _, _, q in poses], joints)
    row = {id(one.target): joints.of_program(one.joints_deg) for one in done}
    texts = {
        one.path.name: one.rewritten(
            [row[id(target)] for target in one.targets],
            {
                span: text
                for (owner, _), new in zip(placed, edits, strict=True)
                if owner is one
                for span, text in new.items()
            },
        )
        for one in programs
    }
    return {
        one.path.name: files_formats.add_correction_mark(one, texts[one.path.name], str(version)) for one in programs
    }


def _skipped_targets(programs: Sequence[Program]) -> list[tuple[Program, int, str]]:
    return [(one, line, what) for one in programs for line, what in one.left]


def _refuse(
    places: Sequence[tuple[Program, int, str]],
    programs: Sequence[Program],
    what: str,
    *,
    strict: bool,
    suspicion: str = "",
) -> None:
    """Refuse a program for these places: to leave ``strict`` out helps only where it was given."""
    if places:
        several = len(programs) > 1
        named = "; ".join(
            f"{f'{one.path.name}, ' if several else ''}line {line}: {said}" for one, line, said in places[:SHOWN]
        )
        more = f" and {len(places) - SHOWN} more" if len(places) > SHOWN else ""
        fits = [said for _, _, said in places if not (suspicion and files_formats.NO_SUCH in said)]
        helps = " ".join(["Nothing is written.", *([suspicion] if suspicion else []), *files_formats.remedies(fits)])
        remedy = f"{helps} Or leave --strict out." if strict else helps
        path = programs[0].path
        at = [{"file": str(one.path), "line": line} for one, line, _ in places]
        context = {"places": at} if several else {"lines": [line for _, line, _ in places]}
        raise FileError(f"{path}: {what}: {named}{more}. {remedy}", file=str(path), **context)


def _report(programs: Sequence[Program], done: AllDone, texts: Mapping[str, str]) -> Document:
    worst = max(done, key=_change)
    held: list[dict[str, Any]] = [
        {
            "file": one.program.path.name,
            "line": one.target.line,
            "name": one.target.name,
            "status": one.status,
            "at_limits": one.at_limits or None,
        }
        for one in done
        if one.status != "OK"
    ]
    diffs = [_diff(one, texts[one.path.name]) for one in programs]
    return {
        "texts": dict(texts),
        "diff": "\n".join(diff for diff in diffs if diff),
        "notes": [*dict.fromkeys(warning for one in programs for warning in one.warnings), *done.notes],
        "dialect": programs[0].dialect,
        "targets": len(done),
        "largest_change_deg": _change(worst),
        "largest_change_file": worst.program.path.name,
        "largest_change_line": worst.target.line,
        "not_ok": held,
        "left": [{"file": one.path.name, "line": line, "what": what} for one in programs for line, what in one.left],
    }


def _change(one: Done) -> float:
    return max(abs(new - old) for new, old in zip(one.joints_deg, one.taught_deg, strict=True))


def _diff(program: Program, new: str) -> str:
    """Return the changed lines as ``diff -U1`` does; each line but marks has its own in the other text."""
    pairs = [*_line_pairs(program.text.split("\n"), new.split("\n"))]
    changed = [k for k, (old, other) in enumerate(pairs) if old != other]
    out = [f"--- {program.path}", "+++ corrected"] if changed else []
    sides = [[0, *itertools.accumulate(pair[k] is not None for pair in pairs)] for k in (0, 1)]
    shown = sorted({at for k in changed for at in (k - 1, k, k + 1) if 0 <= at < len(pairs)})
    for _, hunk in itertools.groupby(enumerate(shown), lambda one: one[1] - one[0]):
        places = [at for _, at in hunk]
        first, end = places[0], places[-1] + 1
        counts = [lines[end] - lines[first] for lines in sides]
        said = [f"{at[first] + (n > 0)}{'' if n == 1 else f',{n}'}" for at, n in zip(sides, counts, strict=True)]
        out.append(f"@@ -{said[0]} +{said[1]} @@")
        for same, block in itertools.groupby(pairs[first:end], lambda pair: pair[0] == pair[1]):
            lines = [*block]
            out += [f"{' ' if same else '-'}{old}" for old, _ in lines if old is not None]
            out += [f"+{other}" for _, other in lines if not same and other is not None]
    return "\n".join(line.rstrip("\r") for line in out)


def _line_pairs(old: Sequence[str], new: Sequence[str]) -> Iterator[tuple[str | None, str | None]]:
    """Each line of a program and the same of the corrected one; a mark stands alone."""
    others = iter(new)
    for line in old:
        if files_formats.is_correction_mark(line):
            yield line, None
            continue
        other = next(others, None)
        while other is not None and files_formats.is_correction_mark(other):
            yield None, other
            other = next(others, None)
        yield line, other
    yield from ((None, other) for other in others)
