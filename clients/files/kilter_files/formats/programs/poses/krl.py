"""The frames of a KRL program: ``$BASE`` and ``$TOOL`` along its text, by literals, numbers and ``FDAT``."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping

from kilter_files.formats.programs.found import NUMBER, Program, blank_strings_and_comments, line_number
from kilter_files.formats.programs.krl_lines import (
    EXTERNAL_PART,
    GIVEN,
    Keyed,
    Tailed,
    has_word,
    parts_handed,
    reassigned_or_passed_variables,
    subprograms,
    variables_passed_to_calls,
)
from kilter_files.formats.programs.notations import KRL, Flow, Frame, InForce, calls_of_own, calls_that_set
from kilter_files.formats.programs.one_target import PoseTarget, Span
from kilter_files.formats.programs.poses.postures import AT_ZERO, StatusTurn, frame_on_track

INDEX = r"\[\s{0,9}\d{1,4}\s{0,9}(?:,\s{0,9}\d{1,4}\s{0,9}){0,2}\]"  # constants, of an array of up to three dimensions
NAME = rf"\w{{1,64}}(?:{INDEX})?"
POSE = Tailed(
    rf"(?:(?<![\w$.])((?:E6)?POS\s{{1,9}})?({NAME})\s{{0,9}}=\s{{0,9}})?",
    r"\{\s{0,9}((?:E6)?POS\s{0,9}:)?\s{0,9}([XYZ]\s[^{}\n]{0,500})\}(?![ \t]*+:)",
)
AGGREGATE_PART = re.compile(rf"\s{{0,9}}(\w{{1,2}})\s{{1,9}}({NUMBER}|'B\s?[01]{{1,16}}')\s{{0,9}}(,|\Z)", re.I)
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
        part = AGGREGATE_PART.match(said, at, end)
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


NULL = Frame(KRL, (0.0,) * 6)
BRACES = r"\{([^{}\r\n]{0,500})\}"
ALONE = rf"{BRACES}(?![ \t]*+:)"  # not the first part of a longer expression
FRAME = Tailed(
    rf"(?<![\w.$])(\$(?:BASE|TOOL)|(?:BASE|TOOL)_DATA\s{{0,9}}\[\s{{0,9}}\d{{1,4}}\s{{0,9}}\]|{NAME})\s{{0,9}}",
    rf"=\s{{0,9}}{ALONE}",
)
FRAMES = Keyed("frame", r"\bFRAME[ \t]+(\w[^=\r\n]{0,300})")
PART = re.compile(rf"\s{{0,9}}(?:(?:FRAME|(?:E6)?POS)\s{{0,9}}:\s{{0,9}})?([XYZABC])\s{{1,9}}({NUMBER})\s{{0,9}}", re.I)
SET = re.compile(
    r"^[ \t]*+(?:\$(BASE|TOOL)[ \t]*+(?:=|(?=\.))[ \t]*+([^\r\n]{1,200})|FDAT_ACT[ \t]*+(?:=|(?=\.))[ \t]*+([^\r\n]{1,300})"
    r"|BAS[ \t]*+\([ \t]*+#(BASE|TOOL|\w{1,30})[ \t]*+,[ \t]*+(\w{1,30}))",
    re.I | re.M,
)
FDAT = Tailed(rf"\b({NAME})\s{{0,9}}", r"=\s{0,9}\{([^{}\r\n]{0,500}\b(?:TOOL|BASE)_NO\b[^{}\r\n]{0,500})\}")
CONTROL = re.compile(
    r"^[ \t]*+(?:(IF|FOR|WHILE|REPEAT|LOOP|SWITCH)\b|(END(?:IF|FOR|WHILE|LOOP|SWITCH)|UNTIL)\b|(ELSE|CASE|DEFAULT)\b"
    r"|(GOTO\b|\w{1,64}[ \t]*+:(?!=)))",
    re.I | re.M,
)
START = re.compile(r"^[ \t]*+(?:GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w{1,64})?[ \t]+(\w{1,64})", re.I | re.M)
CHANGED = re.compile(
    r"^[ \t]*+(BASE|TOOL)_DATA[ \t]*+\[([^\]\r\n]{1,60})\][ \t]*+"
    r"(?:\.|=(?!=)(?![ \t]*+\{[^{}\r\n]{0,500}\}[ \t]*+\r?$))",
    re.I | re.M,
)
WITH = re.compile(
    r"[ \t,]\$(BASE|TOOL)[ \t]*+=[ \t]*+((?:\{[^{}\r\n]{0,500}\}|[^,(\r\n]|\([^()\r\n]{0,200}\)){1,300})", re.I
)
BLOCK = re.compile(r"^[ \t]*+(?:((?:PTP_)?SPLINE)\b([^\r\n]{0,500})|ENDSPLINE\b)", re.I | re.M)
BY_DATA = re.compile(rf"S(?:BASE|TOOL2?)[ \t]*+\([ \t]*+({NAME})(?:\.(?:BASE|TOOL)_NO)?[ \t]*+\)", re.I)
STANDING = re.compile(r"\$IPO_MODE\s{0,9}=\s{0,9}#TCP", re.I)
ORIENTATION = re.compile(
    r"^[ \t]*+(?:\$ORI_TYPE[ \t]*+=[ \t]*+(#\w{1,20})|LDAT_ACT[ \t]*+=[ \t]*+(\w{1,64}|\{[^{}\r\n]{0,500}\}))",
    re.I | re.M,
)
OWN_ORIENTATION = re.compile(r"\$ORI_TYPE[ \t]*+=[ \t]*+(#\w{1,20})", re.I)
MOVE_DATA = Tailed(r"\b(\w{1,64})\s{0,9}", r"=\s{0,9}(\{[^{}\r\n]{0,500}\bORI_TYP\b[^{}\r\n]{0,500}\})")
NOT_TAKEN = re.compile(r"#(?:CONST\w*|IGNORE)\b", re.I)  # the arm keeps the orientation that it has, or finds its own
TOOL_STANDS = "its tool stands still (#TCP)"


class KrlFrames:
    """Base and tool at each place of a program, or why they are not known."""

    def __init__(self, program: Program, text: str) -> None:
        """Read the frames of a program and of the file beside it; ``text`` has its comments blanked."""
        self._stated = program.stated
        texts = [text, *([blank_strings_and_comments(program.beside.text, ";")] if program.beside is not None else [])]
        self._named = {name for one in texts for name in _declared_frame_names(one)}
        listed = [[*FRAME.finditer(one)] for one in texts]
        self.literals = {match.start(2) - 1 for match in listed[0] if self._is_frame(match[1])}
        self._frames: dict[str, Frame | str] = {}
        self._data: dict[str, str] = {}
        self._handed = {name for one in texts for name in variables_passed_to_calls(one)}
        self._given = {name for one in texts for name in reassigned_or_passed_variables(one)} | self._handed
        for one, found in zip(texts, listed, strict=True):
            self._read(one, found)
        self._set_at = {key(match[1]): match.start() for match in reversed(listed[0]) if "_DATA" in match[1].upper()}
        changed = {(match[1].upper(), match[2].strip()) for one in texts for match in CHANGED.finditer(one)}
        self._changed = {(which, number if number.isdigit() else "") for which, number in changed}
        self._text, self._blocks = text, list(BLOCK.finditer(text))
        self._orients, self._sets_by_with = has_word(text, "$ori_type"), has_word(text, "with")
        self._stands = STANDING.search(text) is not None
        ways = (1, -1, 0, None)
        control = [(one.start(), next(w for k, w in enumerate(ways, 1) if one[k])) for one in CONTROL.finditer(text)]
        control = sorted([*control, *((at, 0) for at in calls_of_own(text, START))], key=lambda one: one[0])
        starts = [match.start() for match in START.finditer(text)]
        self.way = Flow(sorted([*control, *((at, 0) for at in subprograms(text))], key=lambda one: one[0]), starts)
        flow = Flow(control, starts)
        self.base: InForce[Frame | str] = InForce(flow)
        self.tool: InForce[Frame | str] = InForce(flow)
        for match in SET.finditer(text):
            self._set(match)
        self._orientation: InForce[bool] = InForce(flow)
        data = {match[1].upper(): match[2] for one in texts for match in MOVE_DATA.finditer(one)}
        for match in ORIENTATION.finditer(text):
            said = match[1] or data.get(match[2].upper(), match[2])
            self._orientation.set(match.start(), NOT_TAKEN.search(said) is not None)
        for which, force in (("base", self.base), ("tool", self.tool)):
            if len({value for _, value in force.settings}) > 1:
                calls = calls_that_set(text, START, flow.owner, [at for at, _ in force.settings])
                force.settings += [(at, f"{name}() sets its {which}") for at, name in calls]
                force.settings.sort(key=lambda one: one[0])

    def _is_frame(self, name: str) -> bool:
        name = key(name)
        return name[0] == "$" or name.startswith(("BASE_DATA[", "TOOL_DATA[")) or name.partition("[")[0] in self._named

    def _read(self, text: str, listed: list[re.Match[str]]) -> None:
        for match in listed:
            name = key(match[1])
            if not self._is_frame(name):
                continue
            found = parse_xyzabc_list(match[2])
            new = Frame(KRL, found) if found else f"{match[1]} is not X, Y, Z, A, B, C with numbers"
            if not name.startswith("$"):
                several = name in self._frames and self._frames[name] != new
                self._frames[name] = f"{match[1]} is set several times" if several else new
        for match in FDAT.finditer(text):
            name = key(match[1])
            self._data[name] = match[2] if self._data.get(name, match[2]) == match[2] else ""

    def _set(self, match: re.Match[str]) -> None:
        at = match.start()
        if match[1]:
            (self.base if match[1].upper() == "BASE" else self.tool).set(
                at, self._value(match[1].upper(), match[2], at)
            )
        elif match[3]:
            for which, force in (("BASE", self.base), ("TOOL", self.tool)):
                force.set(at, self._by_data(which, match[3].strip(), at))
        elif match[4].upper() in ("BASE", "TOOL"):
            (self.base if match[4].upper() == "BASE" else self.tool).set(
                at, self._numbered_frame(match[4].upper(), match[5], at)
            )
        elif match[4].upper() == "INITMOV":  # what was set before it may be so no more
            for which, force in (("base", self.base), ("tool", self.tool)):
                owner = force.flow.owner
                if force.settings and owner(force.settings[-1][0]) == owner(at):
                    force.set(at, f"BAS(#INITMOV) behind it may set its {which} anew")
        elif match[4].upper() in ("EX_BASE", "IPO_M"):
            self.base.set(at, "its base moves, or its tool stands still")

    def _value(self, which: str, said: str, at: int) -> Frame | str:
        said = said.strip()
        if said.startswith("."):
            return f"the program changes ${which}"
        literal = re.fullmatch(BRACES, said)
        if literal:
            found = parse_xyzabc_list(literal[1])
            return Frame(KRL, found) if found else f"${which} is not X, Y, Z, A, B, C with numbers"
        number = re.fullmatch(rf"{which}_DATA\[(\d+)\]", said, re.I)
        if number:
            return self._numbered_frame(which, number[1], at)
        data = BY_DATA.fullmatch(said)
        if data:
            return self._by_data(which, data[1], at)
        if said.upper() in ("$NULLFRAME", "$WORLD"):
            return NULL
        if said.upper() == "$ROBROOT":
            return self._numbered_frame(which, "$ROBROOT", at)
        if key(said).partition("[")[0] in self._given:
            return f"the program changes {said[:40]}"
        return self._frames.get(key(said), f"${which}={said[:40]} is not known")

    def _by_data(self, which: str, name: str, at: int) -> Frame | str:
        """The frame that an ``FDAT`` names, as a spline motion takes it."""
        if name.startswith("."):
            return "the program changes FDAT_ACT"
        if key(name).partition("[")[0] in self._given:
            return f"the program changes {name[:40]}"
        fields = self._fields(name)
        if fields.get("IPO_FRAME", "").upper() == "#TCP":
            return TOOL_STANDS
        number = fields.get(f"{which}_NO")
        return (
            self._numbered_frame(which, number, at)
            if number
            else f"{name[:40]} is not in this program, which says base and tool"
        )

    def _fields(self, name: str) -> dict[str, str]:
        literal = re.fullmatch(BRACES, name)
        found = re.findall(r"(\w+)\s+([^,\s]+)", literal[1] if literal else self._data.get(key(name), ""))
        return {field.upper(): value for field, value in found}

    def _numbered_frame(self, which: str, number: str | None, at: int) -> Frame | str:
        if f"{which}_DATA" in self._handed or not self._changed.isdisjoint(((which, number), (which, ""))):
            return f"the program changes {which}_DATA[{number}]"
        found = self._frames.get(f"{which}_DATA[{number}]")
        first = self._set_at.get(f"{which}_DATA[{number}]", at)
        if at < first and self.way.owner(at) == self.way.owner(first):
            return f"{which}_DATA[{number}] is set after it"
        stated = (self._stated.bases if which == "BASE" else self._stated.tools).get(str(number))
        if found is None and stated is not None:
            return Frame(KRL, stated)
        if found is None and number == "0":
            return NULL
        option = which.lower()
        said = f"{number}=X,Y,Z,A,B,C"
        said = said if str(number).isalnum() else f"'{said}'"  # a shell reads $
        return found or f"{option} {number} is not in this program: state it, --{option} {said}"

    def base_and_tool(self, place: int) -> tuple[tuple[Frame, ...] | str, Frame | str]:
        """Return base and tool of the motion at a place, or why they are not known."""
        own = self._frames_from_with_clause(place)
        base = own.get("BASE") or self._frame_in_effect("base", self.base, place)
        tool = TOOL_STANDS if self._stands else own.get("TOOL") or self._frame_in_effect("tool", self.tool, place)
        return base if isinstance(base, str) else (base,), tool

    def keeps_orientation(self, place: int) -> bool:
        """Say whether a motion along a line or arc surely takes the orientation of its target."""
        known, not_taken = self._orientation.value_in_effect(place)
        for said in self._block_and_motion_text(place) if self._orients else ():
            own = OWN_ORIENTATION.search(said)
            known, not_taken = (True, NOT_TAKEN.search(own[1]) is not None) if own else (known, not_taken)
        return known and not not_taken

    def _block_and_motion_text(self, place: int) -> tuple[str, str]:
        """What begins the spline in which a motion stands, and what the motion itself says."""
        k = bisect_right(self._blocks, place, key=re.Match.start) - 1
        end = self._text.find("\n", place)
        block = self._blocks[k][2] if k >= 0 and self._blocks[k][1] else ""
        return block, self._text[place : end if end >= 0 else None]

    def _frames_from_with_clause(self, place: int) -> dict[str, Frame | str]:
        """Frames that a spline motion sets for itself by WITH, or the block that it stands in."""
        frames: dict[str, Frame | str] = {}
        for said in self._block_and_motion_text(place) if self._sets_by_with else ():
            _, _, with_ = f" {said.strip()}".upper().partition(" WITH ")
            frames |= {
                match[1].upper(): self._value(match[1].upper(), match[2], place) for match in WITH.finditer(f" {with_}")
            }
        return frames

    def _frame_in_effect(self, which: str, force: InForce[Frame | str], place: int) -> Frame | str:
        known, value = force.value_in_effect(place)
        if not known:
            return f"its {which} depends on the way that the program took"
        if value is not None:
            return value
        stated = (self._stated.bases if which == "base" else self._stated.tools).get("")
        return Frame(KRL, stated) if stated else f"its {which} is not set before it: state it, --{which} X,Y,Z,A,B,C"


def _declared_frame_names(text: str) -> Iterator[str]:
    """Yield the names, in capitals, that are declared as frames."""
    for match in FRAMES.finditer(text):
        for one in re.sub(r"\[[^\]]*\]", "", match[1]).split(","):
            yield one.strip().upper()


def parse_xyzabc_list(inside: str) -> tuple[float, ...] | None:
    """Return X, Y, Z, A, B, C of a list in braces; None where one is missing."""
    found = {match[1].upper(): float(match[2]) for match in _labelled_number_matches(inside)}
    return tuple(found[name] for name in KRL.names) if found.keys() == set(KRL.names) else None


def _labelled_number_matches(inside: str) -> Iterator[re.Match[str]]:
    for part in inside.split(","):
        match = PART.fullmatch(part)
        if match:
            yield match
