"""Poses of KRL at their places: six numbers, ``S`` and ``T``; and what changes them elsewhere in the program."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from kilter_files.formats.programs.found import NUMBER, Program, blank_strings_and_comments, line_number
from kilter_files.formats.programs.keyed import Tailed
from kilter_files.formats.programs.krl_lines import EXTERNAL_PART, GIVEN, parts_handed
from kilter_files.formats.programs.notations import KRL
from kilter_files.formats.programs.one_target import PoseTarget, Span
from kilter_files.formats.programs.poses.configurations import StatusTurn
from kilter_files.formats.programs.poses.track import AT_ZERO, frame_on_track

INDEX = r"\[\s{0,9}\d{1,4}\s{0,9}(?:,\s{0,9}\d{1,4}\s{0,9}){0,2}\]"  # constants, of an array of up to three dimensions
NAME = rf"\w{{1,64}}(?:{INDEX})?"
POSE = Tailed(
    rf"(?:(?<![\w$.])((?:E6)?POS\s{{1,9}})?({NAME})\s{{0,9}}=\s{{0,9}})?",
    r"\{\s{0,9}((?:E6)?POS\s{0,9}:)?\s{0,9}([XYZ]\s[^{}\n]{0,500})\}(?![ \t]*+:)",
)
PART = re.compile(rf"\s{{0,9}}(\w{{1,2}})\s{{1,9}}({NUMBER}|'B\s?[01]{{1,16}}')\s{{0,9}}(,|\Z)", re.I)
USUAL_NAMES = "XYZABCST"
SIX, BOTH = (",".join(rf"\s{{0,9}}{name}\s{{1,9}}({NUMBER})\s{{0,9}}" for name in names) for names in ("XYZABC", "ST"))
USUAL = re.compile(rf"{SIX}(?:,{BOTH})?", re.I)
COMPUTED_INDEX = re.compile(r"(?<![\w$.])(\w{1,64})[ \t]*+\[[ \t\d,]*+[^ \t\d,\]]")
BRANCH_BITS, TAUGHT_ABSOLUTE = 0b111, 0b10000  # of S; KUKA keeps its bit 3 zero
TWICE = "bit 4 of its S says that a controller with absolute accuracy taught it: it would be corrected twice"


EXTERNAL_AXIS = re.compile(
    rf"[{{,]\s{{0,9}}E([1-6])\s{{1,9}}({NUMBER}|\w{{1,64}})|\.\s{{0,9}}E([1-6])\s{{0,9}}=(?!=)", re.I
)
OTHER_LINE = re.compile(r"[ \t]*+\$")  # a variable of the system


def key(name: str) -> str:
    """Return the name of a variable, or of an element of an array, as names are compared."""
    return "".join(name.split()).upper()


def parse_pose_target(program: Program, match: re.Match[str]) -> PoseTarget:
    """Read a pose as ``POSE`` finds it; what it lacks is its problem."""
    parts: dict[str, tuple[str, Span]] = {}
    said, problem, at, end = match.string, "", match.start(4), match.end(4)
    usual = USUAL.fullmatch(said, at, end)
    if usual is not None:
        count = 8 if usual[7] else 6
        found = zip(usual.groups()[:count], usual.regs[1 : 1 + count], strict=True)
        parts, at = dict(zip(USUAL_NAMES[:count], found, strict=True)), end + 1
    while at <= end:
        part = PART.match(said, at, end)
        if part is None:
            cell = said[at:end].partition(",")[0]
            problem = problem or f"{cell.strip()[:20]!r} is not a number"
            at += len(cell) + 1
        else:
            parts[part[1].upper()] = (part[2], part.span(2))
            at = part.end() if part[3] else end + 1
    six = [parts[name] for name in KRL.names if name in parts]
    if len(six) < len(KRL.names) and not problem:
        problem = f"without {', '.join(name for name in KRL.names if name not in parts)}"
    axes = {name: _value(text) for name, (text, _) in parts.items() if name[0] == "E"} if len(parts) > len(six) else {}
    root, why = frame_on_track(program.stated, KRL, axes)
    problem = problem or why
    if "S" in parts:
        problem = problem or _of_status(int(_value(parts["S"][0])))
    whole = len(six) == len(KRL.names)
    numbers = tuple(_value(text) for text, _ in six) if whole else (0.0,) * len(KRL.names)
    spans = tuple(span for _, span in six)
    stated = None
    if "S" in parts and "T" in parts:
        status, (turn, span) = parts["S"][0], parts["T"]
        stated = StatusTurn(int(_value(status)), int(_value(turn)), turn, span)
    name = "".join(match[2].split()) if match[2] else "a move"
    line = line_number(program.text, match.start())
    return PoseTarget(name, line, KRL, numbers, spans, stated, problem=problem, whole=match.span(4), root=root)


def _of_status(status: int) -> str:
    """What speaks against a pose with this S."""
    if status & TAUGHT_ABSOLUTE:
        return TWICE
    return f"its S is {status}, which has bits that are not understood" if status & ~BRANCH_BITS else ""


def _value(text: str) -> float:
    return float(int(text.strip("'")[1:], 2)) if text.startswith("'") else float(text)


def note_changes(text: str, poses: Mapping[str, PoseTarget]) -> None:
    """Note poses that the program changes by other statements than a list of numbers."""
    bases: dict[str, list[PoseTarget]] = {}
    for name, pose in poses.items():
        bases.setdefault(name.partition("[")[0], []).append(pose)
    changed = {match[1].upper() for match in GIVEN.finditer(text) if not EXTERNAL_PART.match(match[2])}
    reasons = dict.fromkeys(changed, "the program changes it")
    for by, name in parts_handed(text):
        reasons.setdefault(name, f"{by} may change it")
    for name, reason in reasons.items():
        for pose in bases.get(name, ()):
            pose.problem = pose.problem or reason


def note_external(program: Program) -> None:
    """Note poses that do not say where an external axis is which the program moves: it stays where it was."""
    files = [program, *([program.beside] if program.beside is not None else [])]
    stays = {name for name, track in program.stated.tracks.items() if not any(track.along)}
    moved = {axis for one in files for axis in _moving_external_axes(one.text) if f"e{axis}" not in stays}
    for one in files if moved else ():
        for pose in one.cartesian:
            start, end = pose.whole
            missing = sorted(moved - {match[1] for match in EXTERNAL_AXIS.finditer(one.text, start, end)})
            if missing:
                pose.problem = pose.problem or f"it does not state E{missing[0]}, which the program moves"


def _moving_external_axes(text: str) -> Iterator[str]:
    """The external axes that a program moves from zero."""
    for line in blank_strings_and_comments(text, ";").splitlines():
        if not ("E" in line or "e" in line) or OTHER_LINE.match(line):
            continue
        for match in EXTERNAL_AXIS.finditer(line):
            value = match[2]
            if value is None or re.fullmatch(NUMBER, value) is None or abs(float(value)) > AT_ZERO:
                yield match[1] or match[3]
